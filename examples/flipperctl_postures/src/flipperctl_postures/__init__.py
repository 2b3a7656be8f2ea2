"""The controller ``postures`` for flipperctl; importing this package registers it."""

from flipperctl_postures.postures import Postures

__all__ = ["Postures"]
