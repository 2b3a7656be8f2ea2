"""The built-in plugins; like third-party plugins, they import ``flipperctl.api`` and libraries."""

from flipperctl_plugins import controllers, networks, rewards, terrains

__all__ = ["controllers", "networks", "rewards", "terrains"]
