"""Built-in reward terms: the paper's three."""

from flipperctl_plugins.rewards import end, flipper, pitch

__all__ = ["end", "flipper", "pitch"]
