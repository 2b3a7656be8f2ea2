"""Controllers that plan in simulation; importing this package registers them."""

from flipperctl.lookahead.controllers import Mpc, Planner, ValueIteration

__all__ = ["Mpc", "Planner", "ValueIteration"]
