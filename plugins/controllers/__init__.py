"""Built-in controllers: baselines that need no training, and rules that learn their numbers."""

from . import geometric, hfc, rules, sides, zimmermann

__all__ = ["geometric", "hfc", "rules", "sides", "zimmermann"]
