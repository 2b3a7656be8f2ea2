"""Built-in controllers: baselines that need no training."""

from . import rules

__all__ = ["rules"]
