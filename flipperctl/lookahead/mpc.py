"""``mpc``: registers the receding-horizon controller."""

from __future__ import annotations

from typing import ClassVar

from flipperctl.api import Controller, Policy, controller
from flipperctl.lookahead.mpc_settings import MpcSettings


@controller("mpc")
class Mpc(MpcSettings, Controller):
    """Model predictive control: plan on the perceived ground, take one action, plan again.

    At each decision a beam search simulates a nominal robot on the perceived ground and takes the
    first action of the cheapest plan. The cost of a plan is its lost time plus, weighted in
    seconds, its pitch variation, its postures and its pitch at the horizon. The controller needs
    no training and runs in real time on one core.
    """

    baselines: ClassVar[tuple[str, ...]] = ("okada", "level")

    def build(self) -> Policy:
        """Return a policy that plans with these settings."""
        from flipperctl.lookahead.policy import MpcPolicy

        return MpcPolicy(self)
