"""Recorded drives: what the devices on a robot measured, and where the robot truly was.

In: a terrain and a seed. Out: messages and true poses, which any number of estimators can be given.
The robot is driven by a policy that perceives with ``perception.pose=true``, so that the drives do
not depend on the estimators that are compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    Estimator,
    FloatArray,
    Instrument,
    Measured,
    Mounting,
    Perception,
    RobotGeometry,
    Transition,
)
from flipperctl.checkpoint import shipped_policies
from flipperctl.core.lidar.messages import Belts, Inertial
from flipperctl.core.observation import mean_heights
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.pictures import Observer
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import decisions
from flipperctl.sim.lidar import LidarSensor

FAMILIES: Mapping[str, dict[str, Any]] = {
    "flat": {"length": 10.0},
    "step": {"platform": 7.0},
    "stair": {},
    "building_stair": {"fewest": 10, "most": 10},
    "ramp": {"platform": 4.0},
    "uplift": {},
    "gap": {},
    "wave": {"fewest": 8, "most": 8},
    "rubble": {"fewest": 20, "most": 20},
    "pallet": {"fewest": 6, "most": 6},
    "plum": {"fewest": 8, "most": 8},
}
"""Kinds of ground, with settings that make short ones longer."""
_SPACING = 0.02
"""Distance between the points of the true ground [m]."""
_ROOM = 30.0
"""Length of the true ground before and after the terrain [m]."""


@dataclass(frozen=True)
class Decided:
    """The truth when a policy decided."""

    time: float
    """Time since the start [s]."""
    received: int
    """Number of messages until then [-]."""
    pose: FloatArray
    """(4,) x, y, z [m] and heading [rad] of the chassis centre."""
    heights: FloatArray
    """(N,) heights of the true ground in frame L [m]."""


@dataclass(frozen=True)
class Recorded:
    """One drive."""

    messages: tuple[Measured, ...]
    """What belts, inertial unit, encoders and LiDAR measured, in the order of arrival."""
    decided: tuple[Decided, ...]
    """The truth at each decision."""

    @property
    def way(self) -> float:
        """Distance that the robot moved along x [m]."""
        return float(self.decided[-1].pose[0] - self.decided[0].pose[0])


class _Recording(LidarSensor):
    """Measures for odometry, and perceives by the true pose."""

    def instruments(self, mounting: Mounting) -> Mapping[str, Instrument]:
        """Return those of both kinds of poses."""
        fields = {name: getattr(self, name) for name in LidarSensor.model_fields}
        measured = LidarSensor(**{**fields, "pose": "belts"}).instruments(mounting)
        tracked = LidarSensor(**fields).instruments(mounting)
        return {**{k: v for k, v in tracked.items() if k.startswith("tracking")}, **measured}

    def estimator(self, robot: RobotGeometry) -> Estimator:
        """Return an estimator that ignores odometry."""
        found = super().estimator(robot)
        receive = found.update

        def update(measured: Measured) -> None:
            if not isinstance(measured.value, Belts | Inertial):
                receive(measured)

        found.update = update  # type: ignore[method-assign]  # of this estimator alone
        return found


class _Recorder(Observer):
    def __init__(self) -> None:
        self.messages: list[Measured] = []
        self.decisions: list[Decided] = []

    def measured(self, measured: Measured) -> None:
        if not measured.instrument.startswith("tracking"):
            self.messages.append(measured)

    def decided(self, t: Transition, p: Perception, rewards: Mapping[str, float]) -> None:
        s = t.before
        after = [m.time > s.time + 1e-6 for m in self.messages]
        received = after.index(True) if True in after else len(after)
        pose = np.array([s.position[0], s.side, s.position[1], s.yaw])
        cloud = t.profile.sample(_SPACING, p.layout.reach + _ROOM) - s.position
        inside = (cloud[:, 0] >= -p.layout.reach) & (cloud[:, 0] < p.layout.reach)
        heights = mean_heights(cloud[inside], p.layout.bins, p.layout.bin_width)
        self.decisions.append(Decided(s.time, received, pose, heights))


def record(
    family: str,
    seed: int,
    *,
    sensor: Mapping[str, Any],
    policy: str = "generalist",
    sim: Mapping[str, Any] | None = None,
) -> Recorded:
    """Drive over one ground of a family; ``sensor`` are settings of ``perception=lidar``."""
    terrain = {"name": family, **FAMILIES.get(family, {})}
    engine = {"name": "mujoco", **(sim or {})}
    env = FlipperEnv(terrain, sim=engine, perception=_Recording(**sensor))
    shipped = shipped_policies()
    source = (
        PolicySource(checkpoint=shipped[policy])
        if policy in shipped
        else PolicySource.of_plugin(policy, "policy")
    )
    driver = source.build(env.config)
    recorder = _Recorder()
    for _ in decisions(env, driver, seed, observers=[recorder]):
        pass
    return Recorded(tuple(recorder.messages), tuple(recorder.decisions))


def occupied(heights: FloatArray) -> NDArray[np.bool_]:
    """Return which bins lie under the chassis: those within 0.38 m of its centre."""
    width = 0.15
    middle = (np.arange(len(heights)) - (len(heights) - 1) / 2) * width
    return np.asarray(np.abs(middle) < 0.38)
