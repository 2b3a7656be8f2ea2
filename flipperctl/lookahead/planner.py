"""``planner``: the settings of the search for the best known way across a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from pydantic import Field, PrivateAttr

from flipperctl.api import Controller, Policy, controller
from flipperctl.errors import ConfigError

if TYPE_CHECKING:
    from flipperctl.lookahead.best_known import PlannerPolicy


@controller("planner")
class Planner(Controller):
    """The best known drive across the scene, found before the episode begins; then it is played.

    A drive costs its time plus ``smoothness`` seconds for each radian of θ̂_R at 100 Hz. The search
    begins with the drives of ``level``, ``okada``, ``mpc`` and ``policy``, then drives by beam
    searches over the true ground with ``width`` and twice ``width`` nodes, and improves the best of
    all. Every drive is played in the simulated scene, which decides. With a ``smoothness`` above 0,
    none is chosen that is rougher than a drive that the search began with. It is a yardstick for
    policies and cannot run on a robot.
    """

    searches_first: ClassVar[bool] = True
    baselines: ClassVar[tuple[str, ...]] = ("okada", "level")
    width: int = Field(
        40, ge=1, le=10_000, description="beam width: nodes expanded in each distance bin [-]"
    )
    smoothness: float = Field(
        30.0, ge=0, le=1000, description="time that a radian of pitch variation is worth [s/rad]"
    )
    budget: int = Field(
        200_000,
        ge=1,
        le=100_000_000,
        description="largest number of predicted decisions in the searches of an episode [-]",
    )
    stretch: float = Field(
        0.12, gt=0.001, le=1, description="length of a distance bin, in which nodes compete [m]"
    )
    cell: float = Field(
        0.02,
        gt=0.0001,
        le=1,
        description="nodes closer than this in position and pitch, with equal flipper angles, are "
        "merged into the cheapest [m, rad]",
    )
    policy: str = Field(
        "",
        description="a run, a checkpoint, an .onnx file or a shipped policy whose drive the search "
        "starts from as well; empty: none [-]",
    )

    _trained: Policy | None = PrivateAttr(None)

    def starting_from(self, trained: Policy) -> Planner:
        """Return these settings with the policy that ``policy`` names.

        Files are read by the caller: this package knows neither checkpoints nor networks.
        """
        settings = self.model_copy()
        settings._trained = trained
        return settings

    def build(self) -> PlannerPolicy:
        """Return a policy that searches for a plan at the start of each episode.

        Raises:
            ConfigError: ``policy`` names one, and ``starting_from`` was not given it.
        """
        from flipperctl.lookahead.best_known import PlannerPolicy

        if self.policy and self._trained is None:
            raise ConfigError(
                f"controller.policy={self.policy}: this command reads no policy for the planner; "
                "flipperctl eval and inspect reward do"
            )
        return PlannerPolicy(self, self._trained)
