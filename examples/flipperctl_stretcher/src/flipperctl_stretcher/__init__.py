"""The reward ``stretcher`` for flipperctl; importing this package registers it."""

from flipperctl_stretcher.stretcher import Stretcher

__all__ = ["Stretcher"]
