"""The inertial unit and the belts' encoders of ``perception=lidar``.

In: the true state. Out: messages of ``flipperctl.core.lidar`` at 100 Hz.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Instrument, RobotState
from flipperctl.core.lidar.messages import Belts, Inertial

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
        last, self._yaw = self._yaw, state.yaw
        turned = 0.0 if last is None else math.remainder(state.yaw - last, 2 * math.pi)
        rate = turned / PERIOD + errors.yaw_rate_bias + errors.yaw_rate_noise * float(noise[4])
        return Inertial(roll=state.roll + roll, pitch=state.pitch + pitch, yaw_rate=rate)

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot of the slow error and of the latest heading."""
        return self._tilt, self._yaw

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        self._tilt, self._yaw = saved


class BeltEncoders(Instrument):
    """Measures the speed at which the belts run; the engines keep it constant."""

    period = PERIOD

    def __init__(self, speed: float) -> None:
        """``speed``: what the encoders show, with their constant error [m/s]."""
        self._speed = speed

    def measure(self, state: RobotState, rng: np.random.Generator) -> Belts:
        """Return the speed."""
        return Belts(self._speed)
