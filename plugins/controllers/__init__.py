"""Built-in controllers: baselines that need no training."""

from . import level, okada, planner, random

__all__ = ["level", "okada", "planner", "random"]
