"""Controllers that simulate what lies ahead; importing this package registers ``mpc``."""

from flipperctl.lookahead.mpc import Mpc

__all__ = ["Mpc"]
