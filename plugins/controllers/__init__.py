"""Built-in controllers: baselines that need no training."""

from flipperctl_plugins.controllers import level, okada, planner, random

__all__ = ["level", "okada", "planner", "random"]
