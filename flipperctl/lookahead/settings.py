"""The fields of ``mpc``, ``planner`` and ``value_iteration``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from pydantic import Field, model_validator

from flipperctl.api import Settings
from flipperctl.config.models import AnyRewards

STEEP_FROM, STEEP = 0.9, 30.0
"""Pitch above which steepness is charged, below overturning [rad], and its cost weight [s/rad]."""

SHIPPED = "mpc_value"
"""Name of the shipped policy whose values end the horizon by default."""
HAND_SET = (
    "swing",
    "pitch",
    "lean",
    "flippers",
    "turn",
    "standstill",
    "standstill_from",
    "steep",
    "steep_from",
    "wider",
    "stuck_from",
)
"""Fields of the hand-set cost, which have no effect with ``value`` unless it hurries."""


class MpcSettings(Settings):
    """Size of the search, cost weights of a plan, and settings of the prediction model."""

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
        # Any changed setting of the hand-set cost asks for that cost, and so do rewards without a
        # value.
        defaults = {name: cls.model_fields[name].default for name in HAND_SET if name in data}
        changed = any(data[name] != default for name, default in defaults.items())
        if changed or data.get("rewards") is not None:
            return {**data, "value": ""}
        fallback = data.get("fallback")
        return {**data, "value": SHIPPED, "fallback": True if fallback is None else fallback}

    @property
    def assumed_friction(self) -> float:
        """Friction in the simulation, unless it is known [-]."""
        if self.friction is not None:
            return self.friction
        return 1.0 if self.value else 0.8


class PlannerSettings(Settings):
    """Size of the search, and the cost weight of pitch variation."""

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


class ValueIterationSettings(Settings):
    """Settings of the search of all states, and of the states that a student learns from."""

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


class RolloutSettings(Settings):
    """Whose actions are tried, how many, how far, and what the way and the posture cost."""

    policy: str = Field(
        "generalist",
        description="a run, a checkpoint, an exported file or a shipped policy of Q-values, which "
        "proposes the actions and drives on after them [-]",
    )
    breadth: int = Field(10, ge=1, le=81, description="best actions that are tried [-]")
    horizon: int = Field(6, ge=1, le=100, description="decisions of each trial [-]")
    roll: float = Field(1.0, ge=0, le=100, description="cost of roll beside that of pitch [-]")
    behind: float = Field(
        0.8, ge=0, le=100, description="cost of a metre less than the belts' speed makes [rad/m]"
    )
    posture: float = Field(
        0.5, ge=0, le=100, description="cost of a radian of pitch and roll at the end [-]"
    )
