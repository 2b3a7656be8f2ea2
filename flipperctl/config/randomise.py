"""Randomisation of an episode's physics and sensing: which settings are sampled, in which range.

In: the section ``randomise`` of a configuration and a generator. Out: values that replace
the settings of the same names for one episode; ``sampled`` puts them there.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from flipperctl.api import SAMPLE_PERIOD, Settings


def _pair(value: object) -> object:
    return [value, value] if isinstance(value, int | float) else value


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    low, high = value
    if low > high:
        raise ValueError(f"a range is [low, high] with low ≤ high; got [{low:g}, {high:g}]")
    return value


Range = Annotated[tuple[float, float], BeforeValidator(_pair), AfterValidator(_ordered)] | None
"""Bounds of a uniform distribution; None leaves the setting as it is."""

SECTION_OF = {
    "friction": "sim",
    "chassis_mass": "robot",
    "flipper_mass": "robot",
    "track_speed": "robot",
    "flipper_speed": "robot",
    "actuator_delay": "robot",
    "noise": "perception",
    "dropout": "perception",
    "bias": "perception",
    "horizon": "perception",
    "angle_noise": "perception",
    "pitch_bias": "perception",
    "flipper_bias": "perception",
    "delay": "perception",
    "flipper_torque": "robot",
    "flipper_length": "robot",
    "track_radius": "robot",
    "substep": "sim",
    "iterations": "sim",
}
"""Section of each setting that is sampled from a range; values are sampled in this order."""

SWITCHES = {"occlusion": "perception"}
"""Section of each setting that is on with a probability; sampled after those with a range."""


class Randomise(Settings):
    """The settings that are sampled anew for every episode of a training or an evaluation.

    Each range names a setting of the sections ``sim``, ``robot`` and ``perception``, has its unit
    and must lie within its bounds, and all combinations must be possible; a setting that is on or
    off has a probability. The start is sampled by ``episode.start_noise`` and
    ``episode.start_angle_noise``.
    """

    friction: Range = Field(None, description="of sim.friction [-]")
    chassis_mass: Range = Field(None, description="of robot.chassis_mass [kg]")
    flipper_mass: Range = Field(None, description="of robot.flipper_mass [kg]")
    track_speed: Range = Field(None, description="of robot.track_speed [m/s]")
    flipper_speed: Range = Field(
        None,
        description="of robot.flipper_speed; the decision period stays that of the robot [rad/s]",
    )
    actuator_delay: Range = Field(None, description="of robot.actuator_delay [s]")
    noise: Range = Field(None, description="of perception.noise [m]")
    dropout: Range = Field(None, description="of perception.dropout [-]")
    bias: Range = Field(None, description="of perception.bias [m]")
    horizon: Range = Field(None, description="of perception.horizon [m]")
    angle_noise: Range = Field(None, description="of perception.angle_noise [rad]")
    pitch_bias: Range = Field(None, description="of perception.pitch_bias [rad]")
    flipper_bias: Range = Field(None, description="of perception.flipper_bias [rad]")
    delay: Range = Field(None, description="of perception.delay [s]")
    flipper_torque: Range = Field(None, description="of robot.flipper_torque [N m]")
    flipper_length: Range = Field(
        None, description="of robot.flipper_length; policies still believe in their own robot [m]"
    )
    track_radius: Range = Field(
        None, description="of robot.track_radius; policies still believe in their own robot [m]"
    )
    substep: Range = Field(
        None, description="of sim.substep, as the nearest divisor of the sampling time [s]"
    )
    iterations: Range = Field(None, description="of sim.iterations, as the nearest integer [-]")
    occlusion: float | None = Field(
        None, ge=0, le=1, description="probability of perception.occlusion in an episode [-]"
    )

    def ranges(self) -> Iterator[tuple[str, str, tuple[float, float]]]:
        """Yield the section, name and range of each sampled setting."""
        for name, section in SECTION_OF.items():
            if (found := getattr(self, name)) is not None:
                yield section, name, found

    def probabilities(self) -> Iterator[tuple[str, str, float]]:
        """Yield the section, name and probability of each setting that is switched at random."""
        for name, section in SWITCHES.items():
            if (found := getattr(self, name)) is not None:
                yield section, name, found

    @property
    def names(self) -> list[str]:
        """Names of the sampled settings."""
        return [name for _, name, _ in (*self.ranges(), *self.probabilities())]

    def sample(self, rng: np.random.Generator) -> dict[str, float]:
        """Sample a value of each randomised setting, in SI units; a switch is 1 or 0."""
        values = {name: fitting(name, rng.uniform(*found)) for _, name, found in self.ranges()}
        for _, name, probability in self.probabilities():
            values[name] = float(rng.random() < probability)
        return values


def fitting(name: str, value: float) -> float:
    """Return the value that the setting can have next to a sampled one."""
    if name == "iterations":
        return round(value)
    if name == "substep" and value > 0:  # the engine refuses any other
        return SAMPLE_PERIOD / max(1, round(SAMPLE_PERIOD / value))
    return float(value)
