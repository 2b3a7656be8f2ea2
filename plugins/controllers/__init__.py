"""Built-in controllers: baselines that need no training."""

from . import geometric, rules

__all__ = ["geometric", "rules"]
