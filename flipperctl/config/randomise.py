"""Randomisation of an episode's physics and sensing: the sampled settings and their ranges.

In: the section ``randomise`` of a configuration. Out: the sampled settings in the order in which
their values are sampled; the module ``sampled`` samples them and applies them to the sections.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Self, TypeGuard

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    model_serializer,
    model_validator,
)

from flipperctl.api import Settings
from flipperctl.errors import ConfigError


def _pair(value: object) -> object:
    return [value, value] if _is_number(value) else value


def _is_number(value: object) -> TypeGuard[int | float]:
    """Return whether a value is a number, as true and false are in Python but not in YAML."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    low, high = value
    if low > high:
        raise ValueError(f"a range is [low, high] with low ≤ high; got [{low:g}, {high:g}]")
    return value


def _of_paths(value: object, info: ValidationInfo) -> object:
    """Return the ranges and probabilities of one section, without those that are None."""
    if not isinstance(value, Mapping):
        return value
    where = f"randomise.{info.field_name}"
    given = {str(name): item for name, item in value.items() if item is not None}
    return {name: _range_or_number(item, f"{where}.{name}") for name, item in given.items()}


def _range_or_number(value: object, where: str) -> tuple[float, float] | float:
    items = list(value) if isinstance(value, list | tuple) else [value]
    numbers = [float(item) for item in items if _is_number(item)]
    if len(numbers) == len(items) == 1 and items == [value] and math.isfinite(numbers[0]):
        return numbers[0]
    if len(numbers) == len(items) == 2 and all(map(math.isfinite, numbers)):
        try:
            return _ordered((numbers[0], numbers[1]))
        except ValueError as error:
            raise ConfigError(f"{where}: {error}") from error
    raise ConfigError(
        f"{where}: a range [low, high] or one number is allowed; the value is {value!r:.60}"
    )


Range = Annotated[tuple[float, float], BeforeValidator(_pair), AfterValidator(_ordered)] | None
"""Bounds of a uniform distribution; None leaves the setting as it is."""
Paths = Annotated[dict[str, tuple[float, float] | float], BeforeValidator(_of_paths)]
"""Setting of a section → its range, or one number: its value, or a switch's probability."""

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
"""Section of each setting with a short form; their values are sampled in this order."""

SWITCHES = {"occlusion": "perception"}
"""Section of each short form of a switch with a probability; sampled after those with a range."""

PATH_SECTIONS = ("sim", "robot", "perception")
"""Sections whose settings are sampled by path, after all short forms and in this order."""
OMITTED: Mapping[str, Any] = {"sim": {}, "robot": {}, "perception": {}, "spread": None}
"""Settings that files have only if they are used, with what they are otherwise."""


@dataclass(frozen=True)
class Sampled:
    """One setting that is sampled for every episode."""

    section: str
    field: str
    name: str
    """Short form or path below ``randomise``, which is also the name of the column in files."""
    value: tuple[float, float] | float
    """Range, or one number: the value of a numeric setting or the probability of a switch."""

    @property
    def key(self) -> str:
        """Key of the override."""
        return f"randomise.{self.name}"

    @property
    def ends(self) -> tuple[float, float]:
        """Ends of the range."""
        return self.value if isinstance(self.value, tuple) else (self.value, self.value)


@lru_cache(maxsize=1000)  # it is called for every combination of range ends
def target(name: str) -> tuple[str, str]:
    """Return the section and the field of a short form or of a path such as ``sim.yaw``."""
    section = SECTION_OF.get(name) or SWITCHES.get(name)
    if section is not None:
        return section, name
    section, _, field = name.partition(".")
    return section, field


class Randomise(Settings):
    """The settings that are sampled for every episode of a training or an evaluation.

    ``randomise.<section>.<setting>`` samples any number or switch of the sections ``sim``,
    ``robot`` and ``perception``, including those of plugins; other names are short forms.
    ``randomise.robot.size`` is a factor on all lengths of the robot. Each
    range has the unit of its setting and must lie within its bounds, and all combinations must be
    possible; a switch has a probability. The start is sampled by
    ``episode.start_noise`` and ``episode.start_angle_noise``. With ``spread`` many episodes are
    close to the configured values and some far from them.
    """

    friction: Range = Field(None, description="of sim.friction [-]")
    chassis_mass: Range = Field(None, description="of robot.chassis_mass [kg]")
    flipper_mass: Range = Field(None, description="of robot.flipper_mass [kg]")
    track_speed: Range = Field(None, description="of robot.track_speed [m/s]")
    flipper_speed: Range = Field(
        None,
        description="of robot.flipper_speed; the decision period stays the robot's [rad/s]",
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
        None, description="of robot.flipper_length; policies still assume the configured robot [m]"
    )
    track_radius: Range = Field(
        None, description="of robot.track_radius; policies still assume the configured robot [m]"
    )
    substep: Range = Field(
        None, description="of sim.substep, by the nearest number of substeps in a sampling time [s]"
    )
    iterations: Range = Field(
        None,
        description="of sim.iterations, as the nearest integer, so that both ends of a range are "
        "half as frequent as the numbers between them [-]",
    )
    occlusion: float | None = Field(
        None, ge=0, le=1, description="probability of perception.occlusion in an episode [-]"
    )
    spread: Range = Field(
        None,
        description="share of the way from the configured values to the ends of all ranges, "
        "sampled for each episode; null for the whole ranges [-]",
    )
    sim: Paths = Field(
        default_factory=dict, description="ranges of settings of the engine, by name [-]"
    )
    robot: Paths = Field(
        default_factory=dict, description="ranges of settings of the robot, by name [-]"
    )
    perception: Paths = Field(
        default_factory=dict, description="ranges of settings of the sensor, by name [-]"
    )

    @model_validator(mode="after")
    def _spread_is_a_share(self) -> Self:
        if self.spread is not None and (self.spread[0] < 0 or self.spread[1] > 1):
            text = f"[{self.spread[0]:g}, {self.spread[1]:g}]"
            raise ConfigError(f"randomise.spread: 0 to 1 is allowed; the value is {text}")
        return self

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        seen: dict[tuple[str, str], str] = {}
        for one in self.sampled():
            if (other := seen.get((one.section, one.field))) is not None:
                raise ConfigError(
                    f"{one.key}: randomise.{other} samples the same setting; drop one of the "
                    f"two, for example with {one.key}=null"
                )
            seen[one.section, one.field] = one.name
        return self

    @model_serializer(mode="wrap")
    def _without_empty_sections(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out what is newer and not used, so that hashes stay the same."""
        plain = serialize(self).items()
        return {name: value for name, value in plain if value or name not in OMITTED}

    def sampled(self) -> Iterator[Sampled]:
        """Yield each sampled setting, in the order in which values are sampled.

        The order of the paths in a file does not matter, and a path does not change the samples of
        the short forms.
        """
        for name, section in (*SECTION_OF.items(), *SWITCHES.items()):
            if (found := getattr(self, name)) is not None:
                yield Sampled(section, name, name, found)
        for section in PATH_SECTIONS:
            for field, value in sorted(getattr(self, section).items()):
                yield Sampled(section, field, f"{section}.{field}", value)

    def find(self, section: str, field: str) -> Sampled | None:
        """Return the sampled setting at this place, or None if it is not sampled."""
        found = (s for s in self.sampled() if (s.section, s.field) == (section, field))
        return next(found, None)

    @property
    def names(self) -> list[str]:
        """Names of the sampled settings."""
        return [one.name for one in self.sampled()]
