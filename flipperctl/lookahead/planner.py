"""``planner``: registers the search for the best known trajectory across a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from pydantic import PrivateAttr

from flipperctl.api import Controller, Policy, controller
from flipperctl.errors import ConfigError
from flipperctl.lookahead.planner_settings import PlannerSettings


@controller("planner")
class Planner(PlannerSettings, Controller):
    """Search for the best trajectory across the scene before the episode begins, then play it.

    The cost of a trajectory is its time plus ``smoothness`` seconds for each radian of θ̂_R at
    100 Hz. The search begins with the trajectories of ``level``, ``okada``, ``mpc`` and ``policy``,
    adds those of beam searches on the true ground with ``width`` and twice ``width`` nodes, and
    improves the best one. Every trajectory is played in the simulated scene, which decides its
    outcome and cost. With a ``smoothness`` above 0, the result is no rougher than the smoothest
    trajectory that the search began with. It is a yardstick for policies and cannot run on a robot.
    """

    searches_first: ClassVar[bool] = True
    baselines: ClassVar[tuple[str, ...]] = ("okada", "level")

    _trained: Policy | None = PrivateAttr(None)

    @property
    def named(self) -> Mapping[str, str]:
        """The setting that names a file, and its value; empty without one."""
        return {"policy": self.policy} if self.policy else {}

    def starting_from(self, policies: Sequence[Policy]) -> Planner:
        """Return these settings with the policy that ``policy`` names.

        The caller reads the file: this package knows neither checkpoints nor networks.
        """
        settings = self.model_copy()
        (settings._trained,) = policies
        return settings

    def build(self) -> Policy:
        """Return a policy that searches for a plan at the start of each episode.

        Raises:
            ConfigError: ``policy`` names a policy that ``starting_from`` was not given.
        """
        from flipperctl.lookahead.best_known import PlannerPolicy

        if self.policy and self._trained is None:
            raise ConfigError(
                f"controller.policy={self.policy}: this command reads no policy for the planner; "
                "flipperctl eval and inspect reward do"
            )
        return PlannerPolicy(self, self._trained)
