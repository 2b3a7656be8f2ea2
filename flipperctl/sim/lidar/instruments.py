"""The instruments of ``perception=lidar``: inertial unit, encoders, tracking system.

In: the true state. Out: messages of ``flipperctl.core.lidar`` at 100 Hz. Rotations to the engine's
world and to a level frame differ where the engine tilts gravity in place of the ground: world's z
axis is then not vertical, and roll and pitch are against gravity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Instrument, RobotState
from flipperctl.core.lidar.body import attitude
from flipperctl.core.lidar.messages import Belts, Inertial, Joints, Pose, SpecificForce

_VERTICAL = 1e-12
"""Difference of 1 and the z part of the vertical up to which world's z axis is vertical [-]."""


def to_world(state: RobotState) -> FloatArray:
    """Return the rotation from frame R to world."""
    if state.orientation is not None:
        return state.orientation
    return attitude(state.roll, state.pitch, state.yaw)


def upwards(state: RobotState) -> FloatArray:
    """Return the direction against gravity in frame R, (3,)."""
    x, y = math.sin(state.pitch), math.sin(state.roll)
    z = math.sqrt(max(0.0, 1.0 - x * x - y * y))
    return np.array([x, y, math.copysign(z, math.cos(state.pitch))])


def heading(state: RobotState) -> float:
    """Return the heading of a level frame [rad]: about the vertical, and not about world's z."""
    if state.orientation is None:
        return state.yaw
    level = levelled(state)
    if level[2, 2] > 1.0 - _VERTICAL:
        return state.yaw
    ahead = level @ state.orientation[:, 0]
    return math.atan2(ahead[1], ahead[0])


def levelled(state: RobotState) -> FloatArray:
    """Return the rotation from world to level axes, the first of which is below or above world's x.

    It is the same during an episode.
    """
    if state.orientation is None:
        return np.eye(3)
    up = state.orientation @ upwards(state)
    ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
    ahead /= np.linalg.norm(ahead)
    return np.array([ahead, np.cross(up, ahead), up])


PERIOD = 0.01
"""Time between two measurements [s]."""
_WANDER_TIME = 30.0
"""Time constant of the slow error of roll and pitch [s]."""


@dataclass(frozen=True)
class InertialErrors:
    """Errors of an inertial unit; standard deviations unless stated otherwise."""

    tilt_wander: float
    """Slow error of roll and pitch [rad]."""
    tilt_noise: float
    """White noise of roll and pitch [rad]."""
    yaw_rate_noise: float
    """White noise of the rate of the heading [rad/s]."""
    yaw_rate_bias: float
    """Constant error of the rate of the heading in the episode, not a deviation [rad/s]."""


class InertialUnit(Instrument):
    """Measures the attitude with a slow and a white error, and the rate of the heading."""

    period = PERIOD

    def __init__(self, errors: InertialErrors, rng: np.random.Generator) -> None:
        """``rng``: generator of the slow error at the start."""
        self._errors = errors
        self._tilt: FloatArray = errors.tilt_wander * rng.standard_normal(2)
        self._yaw: float | None = None

    def measure(self, state: RobotState, rng: np.random.Generator) -> Inertial:
        """Return a measurement; the slow error is a first-order Gauss-Markov process."""
        errors = self._errors
        noise = rng.standard_normal(5)
        stays = math.exp(-PERIOD / _WANDER_TIME)
        self._tilt = stays * self._tilt + errors.tilt_wander * math.sqrt(1 - stays**2) * noise[:2]
        roll, pitch = (self._tilt + errors.tilt_noise * noise[2:4]).tolist()
        last, self._yaw = self._yaw, heading(state)
        turned = 0.0 if last is None else math.remainder(self._yaw - last, 2 * math.pi)
        rate = turned / PERIOD + errors.yaw_rate_bias + errors.yaw_rate_noise * float(noise[4])
        return Inertial(roll=state.roll + roll, pitch=state.pitch + pitch, yaw_rate=rate)

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot of the slow error and of the latest heading."""
        return self._tilt, self._yaw

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        self._tilt, self._yaw = saved


class Accelerometer(Instrument):
    """Measures the specific force with a constant and a white error."""

    period = PERIOD

    def __init__(self, noise: float, bias: FloatArray, gravity: float) -> None:
        """``noise``: standard deviation; ``bias``: constant error in frame R, (3,); all [m/s²]."""
        self._noise, self._bias, self._gravity = noise, bias, gravity
        self._last: tuple[float, FloatArray] | None = None  # time [s] and velocity [m/s] in world

    def measure(self, state: RobotState, rng: np.random.Generator) -> SpecificForce:
        """Return the mean specific force since the measurement before; at rest at the first one."""
        vx, vz = state.velocity.tolist()
        velocity, last = np.array([vx, state.side_velocity, vz]), self._last
        self._last = state.time, velocity
        force = self._gravity * upwards(state)
        if last is not None and state.time > last[0]:
            force = force + (velocity - last[1]) / (state.time - last[0]) @ to_world(state)
        return SpecificForce(*(force + self._bias + self._noise * rng.standard_normal(3)).tolist())

    def save(self) -> Any:
        """Return a snapshot of the latest velocity."""
        return self._last

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
        self._last = saved


class BeltEncoders(Instrument):
    """Measures the speeds at which the belts run."""

    period = PERIOD

    def __init__(self, speed: float, error: float) -> None:
        """``speed``: of belts that the engine does not steer [m/s]; ``error``: relative [-]."""
        self._speed, self._scale = speed, 1.0 + error

    def measure(self, state: RobotState, rng: np.random.Generator) -> Belts:
        """Return mean and difference of the speeds, with their constant relative error."""
        belts = np.full(2, self._speed) if state.belts is None else state.belts
        left, right = (self._scale * belts).tolist()
        return Belts(speed=(left + right) / 2, difference=right - left)


class Encoders(Instrument):
    """Measures the angles of the flippers."""

    def __init__(self, period: float | None) -> None:
        self.period = period

    def measure(self, state: RobotState, rng: np.random.Generator) -> Joints:
        """Return the true angles: encoders of geared joints err by far less than a policy feels."""
        return Joints(front=state.front, rear=state.rear)


class Tracking(Instrument):
    """Measures the pose of the robot without error."""

    def __init__(self, period: float | None) -> None:
        self.period = period

    def measure(self, state: RobotState, rng: np.random.Generator) -> Pose:
        """Return the true pose; frame M is the world, levelled if its z axis is not vertical."""
        level = levelled(state)
        x, z = state.position.tolist()
        x, y, z = (level @ [x, state.side, z]).tolist()
        return Pose(x=x, y=y, z=z, roll=state.roll, pitch=state.pitch, yaw=heading(state))
