"""The built-in plugins; they import only ``flipperctl.api`` and libraries, as yours will."""

from . import controllers, networks, rewards, terrains

__all__ = ["controllers", "networks", "rewards", "terrains"]
