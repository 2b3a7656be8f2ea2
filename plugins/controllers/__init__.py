"""Built-in controllers: baselines that need no training."""

from . import level, okada, random

__all__ = ["level", "okada", "random"]
