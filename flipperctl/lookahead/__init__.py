"""Controllers that simulate what lies ahead; importing this package registers them."""

from flipperctl.lookahead.mpc import Mpc
from flipperctl.lookahead.planner import Planner

__all__ = ["Mpc", "Planner"]
