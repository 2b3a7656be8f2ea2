"""The terrain ``trunk`` for flipperctl; importing this package registers it."""

from flipperctl_trunk.trunk import Trunk

__all__ = ["Trunk"]
