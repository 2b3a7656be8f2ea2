"""The inertial unit and the belts' encoders of ``perception=lidar``.

In: the true state. Out: messages of ``flipperctl.core.lidar`` at 100 Hz.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Instrument, RobotState
from flipperctl.core.lidar.messages import Belts, Inertial, SpecificForce
from flipperctl.sim.lidar.frames import heading, to_world, upwards

PERIOD = 0.01
"""Time between two measurements [s]."""


@dataclass(frozen=True)
class InertialErrors:
    """Errors of an inertial unit; standard deviations unless stated otherwise."""

    tilt_wander: float
    """Slow error of roll and pitch [rad]."""
    wander_time: float
    """Time constant of the slow error [s]."""
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
        stays = math.exp(-PERIOD / errors.wander_time)
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
