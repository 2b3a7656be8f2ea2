"""The built-in plugins; like third-party plugins, they import ``flipperctl.api`` and libraries."""

from . import controllers, measures, networks, rewards, terrains

__all__ = ["controllers", "measures", "networks", "rewards", "terrains"]
