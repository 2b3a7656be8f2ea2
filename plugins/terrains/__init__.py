"""Built-in terrains."""

from flipperctl_plugins.terrains import flat, paper_stair, paper_step, stair, step

__all__ = ["flat", "paper_stair", "paper_step", "stair", "step"]
