"""A sensor of your own with two parts: a gyro at 100 Hz, and an estimator of the pitch.

Try it: ``flipperctl eval okada perception=inertial --plugins examples/inertial.py``
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from flipperctl import api
from flipperctl.core.sensing import Measured, SensedAngles, SensedGround


@api.sensor("inertial")
class Inertial(api.Sensor):
    """Integrate the rate of a gyro to the pitch; measure heights and flipper angles directly."""

    bias: float = Field(
        0.0, ge=0, le=0.1, description="largest constant error of an episode's pitch rate [rad/s]"
    )
    noise: float = Field(0.0, ge=0, le=1, description="standard deviation of a pitch rate [rad/s]")

    def instruments(self, mounting: api.Mounting) -> Mapping[str, api.Instrument]:
        bias = self.bias * mounting.rng.uniform(-1, 1)
        return {"gyro": Gyro(bias, self.noise), "view": View(self, mounting.profile)}

    def estimator(self, robot: api.RobotGeometry) -> api.Estimator:
        return PitchIntegrator()


@dataclass(frozen=True)
class Rate:
    """A measurement of the gyro."""

    pitch_rate: float  # [rad/s]


class Gyro(api.Instrument):
    """Measures the pitch rate, with noise and a constant error."""

    period = 0.01

    def __init__(self, bias: float, noise: float) -> None:
        self._bias, self._noise = bias, noise

    def measure(self, state: api.RobotState, rng: np.random.Generator) -> Rate:
        return Rate(state.pitch_rate + self._bias + self._noise * rng.standard_normal())


@dataclass(frozen=True)
class Seen:
    """A measurement of the ground and the flippers, once for each decision."""

    points: NDArray[np.float64]  # (N, 2) in frame L [m]
    front: float  # [rad]
    rear: float  # [rad]


class View(api.Instrument):
    """Measures the ground at the centre of each bin, and the angles of the flippers."""

    def __init__(self, layout: api.ObservationLayout, profile: api.Profile) -> None:
        self._profile = profile
        self._x = (np.arange(layout.bins) + 0.5) * layout.bin_width - layout.reach

    def measure(self, state: api.RobotState, rng: np.random.Generator) -> Seen:
        x, z = state.position
        heights = [self._profile.height(x + ahead) - z for ahead in self._x]
        return Seen(np.column_stack([self._x, heights]), state.front, state.rear)


class PitchIntegrator:
    """The estimator, which runs on a robot too; the chassis is level when an episode begins."""

    def __init__(self) -> None:
        self._time = self._rate = self._pitch = 0.0
        self._seen = Seen(np.zeros((0, 2)), 0.0, 0.0)

    def update(self, measured: Measured) -> None:
        if isinstance(measured.value, Rate):
            rate = measured.value.pitch_rate
            self._pitch += (self._rate + rate) / 2 * (measured.time - self._time)
            self._time, self._rate = measured.time, rate
        elif isinstance(measured.value, Seen):
            self._seen = measured.value

    def estimate(self, time: float) -> tuple[SensedGround, SensedAngles]:
        seen = self._seen
        ground = SensedGround(seen.points)
        return ground, SensedAngles(front=seen.front, rear=seen.rear, pitch=self._pitch)

    def save(self) -> tuple[float, float, float, Seen]:
        return self._time, self._rate, self._pitch, self._seen

    def load(self, saved: tuple[float, float, float, Seen]) -> None:
        self._time, self._rate, self._pitch, self._seen = saved
