"""Randomisation of an episode's physics and sensing: which settings are sampled, in which range.

In: the section ``randomise`` of a configuration and a generator. Out: values that replace
the settings of the same names for one episode.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from flipperctl.api import Settings


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
}
"""Section of each randomised setting; values are sampled in this order."""


class Randomise(Settings):
    """The settings that are sampled anew for every episode of a training or an evaluation.

    Each range names a setting of the sections ``sim``, ``robot`` and ``perception``, has its unit
    and must lie within its bounds. The start is sampled by ``episode.start_noise`` and
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

    def ranges(self) -> Iterator[tuple[str, str, tuple[float, float]]]:
        """Yield the section, name and range of each sampled setting."""
        for name, section in SECTION_OF.items():
            if (found := getattr(self, name)) is not None:
                yield section, name, found

    @property
    def names(self) -> list[str]:
        """Names of the sampled settings."""
        return [name for _, name, _ in self.ranges()]

    def sample(self, rng: np.random.Generator) -> dict[str, float]:
        """Sample a value of each randomised setting, in SI units."""
        return {name: float(rng.uniform(*found)) for _, name, found in self.ranges()}


def replace_settings(sections: Mapping[str, Any], sampled: Mapping[str, float]) -> dict[str, Any]:
    """Return the sections with the sampled values in place of their own."""
    result = dict(sections)
    for name, value in sampled.items():
        section = SECTION_OF[name]
        result[section] = result[section].model_copy(update={name: value})
    return result
