"""The sections of a configuration: every setting, its default, bounds and unit.

"Not given in the paper" in a description marks a value that the paper does not give.
"""

from __future__ import annotations

import math
from typing import Literal, Self

from pydantic import Field, model_validator

from flipperctl.api import Settings

_STUCK_WINDOW = 20
"""Default of ``Episode.stuck_window`` [decisions]."""


class Episode(Settings):
    """Where an episode starts and how it ends."""

    run_up: float = Field(
        1.0,
        ge=-10,
        le=10,
        description="distance from the chassis centre at the start to the first edge; below 0, the "
        "robot starts past the edge, standing on a slope or a stair [m]",
    )
    run_out: float = Field(
        1.0,
        ge=-10,
        le=10,
        description="distance from the last edge to the chassis centre at the finish; below 0, the "
        "episode ends before the last edge, on a slope or a stair [m]",
    )
    start_noise: float = Field(
        0.05,
        ge=0,
        le=0.5,
        description="the start is shifted uniformly by up to ± this distance [m]",
    )
    start_angle_noise: float = Field(
        0.0,
        ge=0,
        le=0.5,
        description="each flipper's start angle is shifted by up to ± this [rad]",
    )
    start_angle: float = Field(
        0.0,
        ge=-1.5,
        le=1.5,
        description="flipper angles at the start; not given in the paper [rad]",
    )
    overturn: float = Field(
        math.pi / 3,
        gt=0,
        le=math.pi / 2,
        description="absolute pitch at which an episode ends as overturned [rad]",
    )
    clearance: float = Field(
        0.1,
        gt=0,
        le=1,
        description="largest height of the chassis' higher end above the ground at the finish; not "
        "given in the paper [m]",
    )
    slack: float = Field(
        3.0,
        gt=1,
        le=100,
        description="t_max as a multiple of the time on level ground; not given in the paper [-]",
    )
    stuck_window: int = Field(
        _STUCK_WINDOW,
        ge=2,
        le=1000,
        description="decisions over which progress is measured if stuck_time is null; not given in "
        "the paper [-]",
    )
    stuck_time: float | None = Field(
        None,
        gt=0,
        le=600,
        description="time of the progress, at least two decisions; null selects stuck_window [s]",
    )
    stuck_progress: float = Field(
        0.1,
        ge=0,
        le=10,
        description="progress in the window below which one is stuck; not given in the paper [m]",
    )

    @model_validator(mode="after")
    def _one_window(self) -> Self:
        if self.stuck_time is not None and self.stuck_window != _STUCK_WINDOW:
            raise ValueError(
                f"stuck_window ({self.stuck_window} decisions) has no effect with stuck_time "
                f"({self.stuck_time:g} s); give one of them"
            )
        return self

    def stuck_decisions(self, period: float) -> int:
        """Return the number of decisions of ``period`` [s] over which progress is measured."""
        if self.stuck_time is None:
            return self.stuck_window
        return max(2, round(self.stuck_time / period))


class Train(Settings):
    """The training run."""

    mode: Literal["fast", "exact"] = Field(
        "fast",
        description="fast: workers play whole episodes while the learner updates, with weights up "
        "to two episodes old; exact: the learner's process plays decision by decision with the "
        "newest weights [-]",
    )
    workers: int = Field(
        1, ge=1, le=1024, description="worker processes that play episodes in mode fast [-]"
    )
    decisions: int = Field(
        60_000, ge=1, le=1_000_000_000, description="decisions of the whole training [-]"
    )
    validate_every: int = Field(5000, ge=1, description="decisions between validations [-]")
    validation_episodes: int = Field(
        40,
        ge=1,
        le=10_000,
        description="episodes per validation, always with the same terrains and starts [-]",
    )
    validation_seed: int = Field(0, ge=0, description="seed of the validation episodes [-]")
    best_by: Literal["success", "return", "last"] = Field(
        "success",
        description="what the best policy is chosen by. success: success rate of its validation, "
        "then θ̂_R at 100 Hz; return: mean return of the rewards without potential-based shaping; "
        "last: the newest validation, for a learning rate that falls to the end [-]",
    )
    regret_episodes: int = Field(
        12,
        ge=0,
        le=10_000,
        description="episodes after the last validation in which the best policy's return is "
        "compared with those of simple rules; 0 for none [-]",
    )
    checkpoint_every: int = Field(
        10_000,
        ge=1,
        description="decisions between full checkpoints, in addition to those at validations [-]",
    )
    record: bool = Field(
        False,
        description="write all training episodes to episodes.safetensors in the run directory [-]",
    )
    keep_policies: bool = Field(
        False,
        description="keep the policy of each validation, as checkpoints/at_<decision>.safetensors, "
        "not only the best one [-]",
    )
    threads: int = Field(1, ge=1, le=256, description="torch threads of the learner [-]")


class LocalCollector(Settings):
    """Episodes are played on this machine, in ``train.workers`` processes."""

    name: Literal["local"] = "local"


class RayCollector(Settings):
    """Episodes are played by actors on a Ray cluster."""

    name: Literal["ray"] = "ray"
    address: str | None = Field(
        None,
        description="cluster's address, such as auto or host:port; null starts a local one [-]",
    )
    workers: int = Field(2, ge=1, le=100_000, description="actors, each on its own CPU [-]")
    max_lag: int = Field(
        20_000,
        ge=1,
        description="an episode is dropped if the learner has advanced by more decisions since it "
        "was requested [-]",
    )
    patience: float = Field(
        300.0, gt=0, description="longest time without a new episode before the run fails [s]"
    )


class Eval(Settings):
    """The evaluation."""

    episodes: int = Field(100, ge=1, le=1_000_000, description="episodes per scene [-]")
    seed: int = Field(
        0,
        ge=0,
        le=2**63 - 1,
        description="seed of the terrains and starts, which differ from those of training [-]",
    )
    jobs: int = Field(1, ge=1, le=1024, description="processes that play episodes [-]")
    cell: int = Field(
        20,
        ge=1,
        le=1_000_000,
        description="episodes of a cell, which a folder of results keeps as one file [-]",
    )
    ray: str | None = Field(
        None,
        description="Ray cluster that plays the cells: address, or local for eval.jobs workers [-]",
    )
