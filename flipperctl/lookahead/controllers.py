"""``mpc``, ``planner`` and ``value_iteration``: the controllers that plan, and a learned value."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr, model_validator

from flipperctl.api import (
    Controller,
    FloatArray,
    ObservationLayout,
    Policy,
    RewardTerm,
    RobotGeometry,
    controller,
)
from flipperctl.config import PAPER_REWARDS
from flipperctl.config.models import AnyRewards
from flipperctl.config.resolver import create
from flipperctl.errors import ConfigError

TOLERANCE = 0.02
"""Largest relative difference of a dimension that was not randomised in the training [-]."""


@dataclass(frozen=True)
class LearnedValue:
    """The value of a trained policy."""

    value: Callable[[NDArray[np.float32]], FloatArray]
    """Returns the expected discounted return from observations (M, N + 3), (M,) [-]."""
    rewards: Mapping[str, RewardTerm]
    """Reward terms that it was trained with."""
    gamma: float
    """Discount per decision [-]."""
    layout: ObservationLayout
    """Layout of its observations."""
    sizes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Smallest and largest dimension of the robots of its training, by field of ``RobotGeometry``
    [m, rad]; those that are missing may have any size."""

    def misfits(self, robot: RobotGeometry, layout: ObservationLayout) -> Iterator[str]:
        """Yield what of a robot and its observations the values were not trained for."""
        for name, (low, high) in self.sizes.items():
            if not low <= (size := getattr(robot, name)) <= high:
                yield f"robot.{name}={size:.4g} ({low:.4g} to {high:.4g})"
        if layout.reach < (1 - TOLERANCE) * self.layout.reach:
            yield f"ground perceived up to {layout.reach:.4g} m ({self.layout.reach:.4g} m)"


STEEP_FROM, STEEP = 0.9, 30.0
"""Pitch above which steepness is charged, below overturning [rad], and its cost weight [s/rad]."""

SHIPPED = "mpc_value"
"""Name of the shipped policy whose values end the horizon by default."""
HAND_SET = (
    *("swing", "pitch", "lean", "flippers", "turn", "standstill", "standstill_from", "steep"),
    *("steep_from", "wider", "stuck_from"),
)
"""Fields of the hand-set cost, which have no effect with ``value`` unless it hurries."""


@controller("mpc")
class Mpc(Controller):
    """Model predictive control: plan on the perceived ground, take one action, plan again.

    At each decision a beam search simulates a nominal robot on the perceived ground and takes the
    first action of the best plan. With ``value``, by default the shipped one, plans have the
    largest return of reward terms, and end with the values of a trained policy. Without it, they
    have the least hand-set cost: lost time plus, weighted in seconds, pitch variation, postures and
    the pitch at the horizon. The controller needs no training of its own and runs in real time on
    one core.
    """

    baselines: ClassVar[tuple[str, ...]] = ("okada", "level")
    reference_settings: ClassVar[Mapping[str, Any]] = {"value": ""}

    value: str | None = Field(
        None,
        description="a run, a checkpoint or a shipped policy whose values end the horizon; plans "
        "then have the largest return of ``rewards`` instead of the least hand-set cost; empty: "
        "the hand-set cost; null: mpc_value, and the hand-set cost if a setting of it (swing, "
        "pitch, lean, flippers, turn, standstill, standstill_from, steep, steep_from, wider, "
        "stuck_from) is not at its default [-]",
    )
    fallback: bool | None = Field(
        None,
        description="whether the hand-set cost replaces ``value`` for a robot of other dimensions "
        "than those of its training, or if less of the ground is perceived; null: only if "
        "``value`` is null [-]",
    )
    rewards: AnyRewards | None = Field(
        None,
        description="reward terms that plans are paid by, or a preset's name, as in "
        "``controller.rewards=smooth``; null: those that ``value`` was trained with [-]",
    )
    hurry_below: float = Field(
        0.0,
        ge=0,
        le=1,
        description="with ``value``: share of full speed below which the best plan is replaced by "
        "one of the hand-set cost, which hurries; also where the robot stands; 0: never [-]",
    )
    beam: int = Field(12, ge=1, le=64, description="nodes kept at each depth of the search [-]")
    horizon: int = Field(9, ge=1, le=20, description="depth of the search in decisions [-]")
    of_each: int = Field(
        0,
        ge=0,
        le=64,
        description="nodes kept at each depth for each first action besides ``beam``; above 0 the "
        "search finds the costs of all actions, which teach a student more [-]",
    )
    wider: float = Field(
        3.0, ge=1, le=8, description="width of the second search as a multiple of ``beam`` [-]"
    )
    stuck_from: float = Field(
        2.5, gt=0, le=100, description="lost time of a plan above which a second search is made [s]"
    )
    swing: float = Field(10.0, ge=0, le=1000, description="cost weight of pitch variation [s/rad]")
    pitch: float = Field(
        10.0, ge=0, le=1000, description="cost weight of the absolute pitch at the horizon [s/rad]"
    )
    lean: float = Field(
        0.1,
        ge=0,
        le=100,
        description="cost weight of the absolute pitch after each decision [s/rad]",
    )
    flippers: float = Field(
        0.04, ge=0, le=100, description="cost weight of flipper angles after each decision [s/rad]"
    )
    turn: float = Field(
        0.02, ge=0, le=10, description="cost of turning a flipper pair in a decision [s]"
    )
    standstill: float = Field(
        3.0,
        ge=0,
        le=100,
        description="additional cost weight of time lost beyond ``standstill_from`` [s/s]",
    )
    standstill_from: float = Field(
        2.0, ge=0, le=100, description="lost time above which a plan counts as standing still [s]"
    )
    steep: float = Field(
        STEEP, ge=0, le=1000, description="cost weight of pitch beyond ``steep_from`` [s/rad]"
    )
    steep_from: float = Field(
        STEEP_FROM, gt=0, le=math.pi / 2, description="pitch above which steepness is charged [rad]"
    )
    overturn: float = Field(
        math.pi / 3, gt=0.1, le=math.pi / 2, description="pitch that no plan may reach [rad]"
    )
    friction: float | None = Field(
        None,
        gt=0,
        le=10,
        description="friction between track and ground in the simulation, unless a privileged "
        "teacher is told the true one; too low a value costs smoothness, with too high a value the "
        "robot gets stuck on slippery stairs; null: 0.8, and 1.0 with ``value``, since a plan for "
        "the largest return gives up steep stairs that it takes for impassable [-]",
    )
    step: float = Field(0.02, ge=0.005, le=0.04, description="time step of the prediction [s]")
    iterations: int = Field(8, ge=1, le=40, description="solver iterations per step [-]")
    memory: int = Field(10, ge=1, le=100, description="scans that are averaged under noise [-]")
    latency: float = Field(
        0.0,
        ge=0,
        le=1,
        description="time from a perception until the flippers turn (sensing, computing, "
        "actuation); the search begins at the state predicted for then [s]",
    )
    time_limit: float | None = Field(
        None,
        gt=0,
        le=60,
        description="time after which a search ends early; only without it are decisions exactly "
        "repeatable [s]",
    )

    @model_validator(mode="before")
    @classmethod
    def _choose_value(cls, data: Any) -> Any:
        """Return the settings with a value in place of null, so that saved ones name it."""
        if not isinstance(data, Mapping) or data.get("value") is not None:
            return data
        own = (name for name in HAND_SET if name in data)
        defaults = {name: cls.model_fields[name].default for name in HAND_SET}
        chosen = any(data[name] != defaults[name] for name in own)
        if chosen or data.get("rewards") is not None:
            return {**data, "value": ""}
        fallback = data.get("fallback")
        return {**data, "value": SHIPPED, "fallback": True if fallback is None else fallback}

    @property
    def assumed_friction(self) -> float:
        """Friction in the simulation, unless it is known [-]."""
        if self.friction is not None:
            return self.friction
        return 1.0 if self.value else 0.8

    _learned: LearnedValue | None = PrivateAttr(None)

    def ending_with(self, learned: LearnedValue) -> Mpc:
        """Return these settings with the values that ``value`` names.

        The caller reads the file: this package knows neither checkpoints nor networks.
        """
        settings = self.model_copy()
        settings._learned = learned
        return settings

    def without_value(self) -> Mpc:
        """Return these settings with the hand-set cost."""
        return self.model_copy(update={"value": ""})

    def build(self) -> Policy:
        """Return a policy that plans with these settings.

        Raises:
            ConfigError: ``value`` names values that ``ending_with`` was not given, there are
                ``rewards`` without it, or a term needs what predictions lack.
        """
        from flipperctl.lookahead.mpc import MpcPolicy, ReturnPolicy

        if self._learned is not None:
            return ReturnPolicy(self, self._learned)
        if self.value:
            raise ConfigError(
                f"controller.value={self.value}: the file of the values was not read; "
                "flipperctl.load and the commands read it, and value='' needs none"
            )
        if self.rewards is not None:
            raise ConfigError(
                "controller.rewards: plans are paid by rewards only with values of what follows "
                "them; set controller.value to a run that was trained with these rewards"
            )
        return MpcPolicy(self)


@controller("planner")
class Planner(Controller):
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

    width: int = Field(
        40, ge=1, le=10_000, description="beam width: nodes expanded in each distance bin [-]"
    )
    smoothness: float = Field(
        30.0, ge=0, le=1000, description="cost weight of pitch variation [s/rad]"
    )
    budget: int = Field(
        200_000,
        ge=1,
        le=100_000_000,
        description="largest number of predicted decisions in the searches of an episode [-]",
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
        description="a run, a checkpoint, an .onnx file or a shipped policy whose trajectory the "
        "search also starts from; empty: none [-]",
    )

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
        from flipperctl.lookahead.planner import PlannerPolicy

        if self.policy and self._trained is None:
            raise ConfigError(
                f"controller.policy={self.policy}: this command reads no policy for the planner; "
                "flipperctl eval and inspect reward do"
            )
        return PlannerPolicy(self, self._trained)


@controller("value_iteration")
class ValueIteration(Controller):
    """Compute the value of every reachable state of the true ground, then act by it.

    Before an episode, the prediction model explores all flipper settings along the whole ground,
    and value iteration on the states found gives the best return of the configured rewards from
    each. It takes one to three seconds. The policy is a yardstick for others and, as a teacher
    (``teacher=searched``), their source of values; it cannot run on a robot.
    """

    searches_first: ClassVar[bool] = True
    closed_loop: ClassVar[bool] = True
    baselines: ClassVar[tuple[str, ...]] = ("okada", "level")

    gamma: float = Field(
        0.99, ge=0, lt=1, description="discount per decision, equal to agent.gamma [-]"
    )
    step: float = Field(0.02, ge=0.005, le=0.04, description="time step of the prediction [s]")
    iterations: int = Field(8, ge=1, le=40, description="solver iterations per step [-]")
    friction: float = Field(
        0.9,
        gt=0,
        le=10,
        description="friction in the prediction if the episode's own is not known [-]",
    )
    horizon: int = Field(
        4, ge=1, le=20, description="decisions that are searched before the values count [-]"
    )
    beam: int = Field(10, ge=1, le=64, description="nodes kept at each depth of that search [-]")
    groups: int = Field(
        96,
        ge=1,
        le=10_000,
        description="groups of states of each ground that a student learns from [-]",
    )
    off_path: float = Field(
        0.4,
        ge=0,
        le=1,
        description="fraction of the groups around states that any flipper setting may reach; the "
        "others lie around states near the best way [-]",
    )
    unseen: float = Field(
        0.0,
        ge=0,
        le=1,
        description="fraction of the groups whose ground is level from some bin ahead on, as a "
        "search on perceived ground takes it to be; for the values of controller.value [-]",
    )

    _rewards: Mapping[str, RewardTerm] | None = PrivateAttr(None)

    def paying(self, rewards: Mapping[str, RewardTerm]) -> ValueIteration:
        """Return these settings with the reward terms that count."""
        settings = self.model_copy()
        settings._rewards = rewards
        return settings

    def build(self) -> Policy:
        """Return a policy that explores the ground at the start of each episode.

        Without ``paying``, the paper's rewards count.

        Raises:
            ConfigError: a term needs what predictions lack.
        """
        from flipperctl.lookahead.value_iteration import ValueIterationPolicy

        rewards = self._rewards
        if rewards is None:
            rewards = {n: create("reward", n, f"rewards.{n}") for n in PAPER_REWARDS.values()}
        return ValueIterationPolicy(self, rewards)
