"""Controllers that plan in simulation; importing this package registers them."""

from flipperctl.lookahead.mpc import Mpc
from flipperctl.lookahead.planner import Planner
from flipperctl.lookahead.value_iteration import ValueIteration

__all__ = ["Mpc", "Planner", "ValueIteration"]
