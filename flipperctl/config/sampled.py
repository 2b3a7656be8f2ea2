"""Settings that are sampled for each episode: their ranges, and the sections with their values.

In: the section ``randomise``, and the sections ``sim``, ``robot`` and ``perception`` that it
samples. Out: the sections of one episode, or an error before any episode if a sample may be
impossible.
"""

from __future__ import annotations

import math
import sys
import types
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Annotated, Any, Final, TypeGuard, Union, get_args, get_origin

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    ValidationError,
    ValidationInfo,
)

from flipperctl.api import Plugin, Range, Settings
from flipperctl.config.resolver import construct
from flipperctl.errors import ConfigError
from flipperctl.text.messages import close_match, explain

Sections = Mapping[str, Settings]
"""Section's name → its settings."""
_MOST = 2**16
"""Largest number of combinations of range ends in one section, which are all checked."""
_possible: deque[tuple[Settings, dict[str, list[float]]]] = deque(maxlen=64)
"""The last sections and range ends all of whose combinations are valid.

A command validates its configuration several times, each with hundreds of combinations.
"""


def _is_finite(value: object) -> TypeGuard[int | float]:
    """Return whether a value is a number that a float can hold; true and false are none in YAML."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= sys.float_info.max


def _of_paths(value: object, info: ValidationInfo) -> object:
    """Return the ranges and probabilities of one section, without those that are None."""
    if not isinstance(value, Mapping):
        return value
    ranges = {str(name): item for name, item in value.items() if item is not None}
    where = f"randomise.{info.field_name}"
    return {name: _range_or_number(item, f"{where}.{name}") for name, item in ranges.items()}


def _range_or_number(value: object, where: str) -> tuple[float, float] | float:
    # One number stands for a range of one value, or for a probability.
    items = list(value) if isinstance(value, list | tuple) else [value]
    numbers = [float(item) for item in items if _is_finite(item)]
    if items == [value] and len(numbers) == 1:
        return numbers[0]
    if len(items) == len(numbers) == 2 and numbers[0] <= numbers[1]:
        return numbers[0], numbers[1]
    raise ConfigError(
        f"{where}: a range [low, high] with low ≤ high, or one number, is allowed; the value is "
        f"{value!r:.60}"
    )


Paths = Annotated[dict[str, tuple[float, float] | float], BeforeValidator(_of_paths)]
"""Setting of a section → its range, or one number: its value, or a switch's probability."""

SECTIONS = ("sim", "robot", "perception")
"""Sections whose settings are sampled."""
FIRST = (
    "sim.friction", "robot.chassis_mass", "robot.flipper_mass", "robot.track_speed",
    "robot.flipper_speed", "robot.actuator_delay", "perception.noise", "perception.dropout",
    "perception.bias", "perception.horizon", "perception.angle_noise", "perception.pitch_bias",
    "perception.flipper_bias", "perception.delay", "robot.flipper_torque", "robot.flipper_length",
    "robot.track_radius", "sim.substep", "sim.iterations", "perception.occlusion",
)  # fmt: skip
"""Settings that are sampled before all others, so that a further one leaves episodes equal."""
_FACTOR: Final = 10.0
"""Ratio of a range's ends from which on its logarithm is sampled evenly [-]."""


@dataclass(frozen=True)
class Sampled:
    """One setting that is sampled for every episode."""

    name: str
    """Path below ``randomise``, which is also the name of the column in files."""
    value: tuple[float, float] | float
    """Range, or one number: the value of a numeric setting or the probability of a switch."""

    @property
    def section(self) -> str:
        """Section of the setting."""
        return self.name.partition(".")[0]

    @property
    def field(self) -> str:
        """Name of the setting within its section."""
        return self.name.partition(".")[2]

    @property
    def key(self) -> str:
        """Key of the override."""
        return f"randomise.{self.name}"

    @property
    def ends(self) -> tuple[float, float]:
        """Ends of the range."""
        return self.value if isinstance(self.value, tuple) else (self.value, self.value)


class Randomise(Settings):
    """The settings that are sampled for every episode of a training or an evaluation.

    ``randomise.<section>.<setting>`` samples any number or switch of the sections ``sim``,
    ``robot`` and ``perception``, also of plugins. ``randomise.robot.size`` is a factor on all
    lengths of the robot. Each range has the unit of its setting and must lie within its bounds, and
    all combinations must be possible; a switch has a probability. The start is sampled by
    ``episode.start_noise`` and ``episode.start_angle_noise``. With ``spread`` many episodes are
    close to the configured values and some far from them. A range from above 0 to ten times its
    start or more is sampled in the logarithm.
    """

    spread: Range | None = Field(
        None,
        ge=0,
        le=1,
        description="share of the way from the configured values to the ends of all ranges, "
        "sampled for each episode; null for the whole ranges [-]",
    )
    sim: Paths = Field({}, description="ranges of settings of the engine, by name [-]")
    robot: Paths = Field({}, description="ranges of settings of the robot, by name [-]")
    perception: Paths = Field({}, description="ranges of settings of the sensor, by name [-]")

    def sampled(self) -> Iterator[Sampled]:
        """Yield each sampled setting, in the order in which values are sampled.

        The order of the paths in a file does not matter.
        """
        ranges = {
            f"{section}.{field}": value
            for section in SECTIONS
            for field, value in sorted(getattr(self, section).items())
        }
        for name in (*FIRST, *(name for name in ranges if name not in FIRST)):
            if name in ranges:
                yield Sampled(name, ranges[name])

    def find(self, section: str, field: str) -> Sampled | None:
        """Return the sampled setting at this place, or None if it is not sampled."""
        matches = (s for s in self.sampled() if (s.section, s.field) == (section, field))
        return next(matches, None)

    @property
    def names(self) -> list[str]:
        """Names of the sampled settings."""
        return [sampled.name for sampled in self.sampled()]


def sample(sections: Sections, randomise: Randomise, rng: np.random.Generator) -> dict[str, float]:
    """Sample a value of each randomised setting, by name in SI units; a switch is 1 or 0.

    ``randomise`` has passed ``check_ranges`` with these sections.
    """
    values = {}
    # One share for all settings: an episode is near the configured values in all or in none.
    share = None if randomise.spread is None else rng.uniform(*randomise.spread)
    for sampled in randomise.sampled():
        section = sections[sampled.section]
        settings, (low, high) = type(section), sampled.ends
        to = math.log if (logarithm := 0 < low <= high / _FACTOR) else float
        # Whole ranges, or the part of them around the configured value
        if share is None:
            start, end = to(low), to(high)
        else:
            middle = to(_configured(section, sampled.field, low, high))
            start, end = (middle + share * (to(value) - middle) for value in (low, high))

        # Each setting, also a switch, takes one random number.
        if _kind(settings, sampled.field) is bool:
            values[sampled.name] = float(rng.random() < start)
        else:
            value = rng.uniform(start, end)
            value = min(high, max(low, math.exp(value))) if logarithm else value
            values[sampled.name] = _allowed(settings, sampled.field, value)
    return values


def _configured(settings: Settings, field: str, low: float, high: float) -> float:
    """Return the configured value of a setting, or the end of its range that is nearest to it.

    A single number in place of a range is no such end: an engine may sample up to it.

    A factor is 1, a switch 0 or 1, and null what ``null_values`` say, else the range's centre.
    """
    cls = type(settings)
    if _kind(cls, field) is bool:
        return float(getattr(settings, field))
    value = 1.0 if field in cls.factors else getattr(settings, field)
    if value is None:
        value = cls.null_values.get(field, 0.5 * (low + high))
    return float(value) if low == high else min(high, max(low, float(value)))


def replace_settings(sections: Sections, sampled: Mapping[str, float]) -> dict[str, Any]:
    """Return the sections with the sampled values in place of their own."""
    result = dict(sections)
    for section in {name.partition(".")[0]: None for name in sampled}:
        values = {name: v for name, v in sampled.items() if name.startswith(f"{section}.")}
        try:
            result[section] = _with_values(result[section], values)
        except ValidationError as error:
            raise _refusal(error, result[section], values) from error
    return result


def check_ranges(sections: Sections, randomise: Randomise) -> None:
    """Check that each setting can be sampled and that all combinations of range ends are valid."""
    # The ends of each section's ranges
    ends: dict[str, dict[str, list[float]]] = {}
    for sampled in randomise.sampled():
        low, high = _check(sampled, sections[sampled.section])
        ends.setdefault(sampled.section, {})[sampled.name] = [low] if low == high else [low, high]

    # All combinations of ends, once for each section and its ranges
    for section, section_ends in ends.items():
        if math.prod(map(len, section_ends.values())) > _MOST:
            raise ConfigError(
                f"randomise: {len(section_ends)} settings of {section} are sampled; at most "
                f"{_MOST.bit_length() - 1} with a range are allowed"
            )
        if (sections[section], section_ends) not in _possible:
            _check_combinations(sections[section], section_ends)
            _possible.append((sections[section], section_ends))


def _check_combinations(settings: Settings, ends: Mapping[str, list[float]]) -> None:
    for combination in product(*ends.values()):
        values = dict(zip(ends, combination, strict=True))
        try:
            _with_values(settings, values)
        except ValidationError as error:
            raise _refusal(error, settings, values) from error


def _check(sampled: Sampled, settings: Settings) -> tuple[float, float]:
    """Return the ends of the samples of a setting that exists and can be sampled."""
    cls, known = type(settings), sorted({*type(settings).model_fields, *type(settings).factors})
    owner = f"{sampled.section}={cls.plugin_name}" if issubclass(cls, Plugin) else sampled.section
    if sampled.field not in known:
        raise ConfigError(
            f"{sampled.key}: {owner} has no setting {sampled.field!r}"
            f"{close_match(sampled.field, known)}; drop it with {sampled.key}=null"
        )
    # What is sampled must be a number or a switch that policies do not rely on.
    kind = _kind(cls, sampled.field)
    if sampled.field in cls.not_sampled or kind is None:
        what = "policies rely on it" if kind else "it is neither a number nor a switch"
        names = [n for n in known if n not in cls.not_sampled and _kind(cls, n)]
        raise ConfigError(
            f"{sampled.key}: {what}, so it cannot be sampled; settings of {owner} that can be "
            f"sampled: {', '.join(names)}"
        )

    # A switch has a probability, whose ends are whether it is ever and always on.
    if kind is bool:
        probability = sampled.value
        if isinstance(probability, tuple) or not 0 <= probability <= 1:
            raise ConfigError(
                f"{sampled.key}: a probability of {sampled.section}.{sampled.field}, 0 to 1, is "
                f"allowed; the value is {probability}"
            )
        return float(probability > 0), float(probability == 1)
    low, high = (_allowed(cls, sampled.field, end) for end in sampled.ends)
    return low, high


@lru_cache(maxsize=1000)  # it is called for every combination of range ends
def _kind(cls: type[Settings], field: str) -> type[bool | int | float] | None:
    """Return the type of a setting or factor that can be sampled, None for any other setting."""
    if field in cls.factors:
        return float
    kinds = set(_types(cls.model_fields[field].annotation)) - {types.NoneType}
    if kinds == {bool}:
        return bool
    if kinds == {int}:
        return int
    return float if kinds in ({float}, {int, float}) else None


def _types(annotation: Any) -> Iterator[Any]:
    """Yield the types in a union, without their bounds."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        yield from _types(parts[0])
    elif origin in (Union, types.UnionType):
        for part in parts:
            yield from _types(part)
    else:
        yield annotation


def _allowed(cls: type[Settings], field: str, value: float) -> float:
    """Return the allowed value of the setting that is nearest to ``value``."""
    nearest = cls.nearest_allowed(field, value)
    return round(nearest) if _kind(cls, field) is int else float(nearest)


def _with_values(settings: Settings, sampled: Mapping[str, float]) -> Settings:
    """Return the settings with the sampled values, which are given by name.

    A factor multiplies the settings of ``Settings.factors``, after these were sampled themselves.
    """
    cls, values = type(settings), {name.partition(".")[2]: value for name, value in sampled.items()}
    # Factors multiply what was sampled itself, so that they come last.
    factors = {name: values.pop(name) for name in cls.factors if name in values}
    switched = {name: bool(v) if _kind(cls, name) is bool else v for name, v in values.items()}
    fields = {**dict(settings), **switched}
    for factor, value in factors.items():
        fields |= {name: value * fields[name] for name in cls.factors[factor]}
    return construct(cls, fields) if issubclass(cls, Plugin) else cls(**fields)


def _refusal(error: ValidationError, settings: Settings, values: Mapping[str, float]) -> Exception:
    """Return an error that names the ranges that make the section impossible."""
    # An error of one field names its range; an error of several names all that could mend it.
    first = error.errors()[0]["loc"]
    for name in values:
        if first and first[0] == name.partition(".")[2]:
            where = f"randomise.{name.partition('.')[0]}"
            return ConfigError(explain(error, where, type(settings)))
    culprits = [name for name in values if _possible_without(name, settings, values)]
    where = ", ".join(f"randomise.{name}" for name in culprits or values)
    return ConfigError(explain(error, where, type(settings)))


def _possible_without(name: str, settings: Settings, values: Mapping[str, float]) -> bool:
    others = {other: value for other, value in values.items() if other != name}
    try:
        _with_values(settings, others)
    except ValidationError:
        return False
    return True
