"""Apply sampled values to the sections of a configuration, validated like other settings.

In: the sections ``sim``, ``robot`` and ``perception``, and sampled values or the ranges of these.
Out: the sections of one episode, or an error before any episode if a sample may be impossible.
"""

from __future__ import annotations

import math
import types
from collections import deque
from collections.abc import Iterator, Mapping
from functools import lru_cache
from itertools import product
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np
from pydantic import ValidationError

from flipperctl.api import Plugin, Settings
from flipperctl.config.randomise import Randomise, Sampled, target
from flipperctl.config.resolver import construct
from flipperctl.errors import ConfigError
from flipperctl.messages import close_match, explain

Sections = Mapping[str, Settings]
"""Section's name → its settings."""
_MOST = 2**16
"""Largest number of combinations of range ends in one section, all of which are checked."""
_possible: deque[tuple[Settings, dict[str, list[float]]]] = deque(maxlen=64)
"""The last sections and range ends all of whose combinations are valid.

A command validates its configuration several times, each with hundreds of combinations.
"""


def sample(sections: Sections, randomise: Randomise, rng: np.random.Generator) -> dict[str, float]:
    """Sample a value of each randomised setting, by name in SI units; a switch is 1 or 0.

    ``randomise`` has passed ``check_ranges`` with these sections.
    """
    values = {}
    share = None if randomise.spread is None else rng.uniform(*randomise.spread)
    for one in randomise.sampled():
        section = sections[one.section]
        settings, (low, high) = type(section), one.ends
        if share is not None:
            middle = _configured(section, one.field, low, high)
            low, high = middle + share * (low - middle), middle + share * (high - middle)
        if _kind(settings, one.field) is bool:
            values[one.name] = float(rng.random() < low)
        else:
            values[one.name] = _allowed(settings, one.field, rng.uniform(low, high))
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
    for section in {target(name)[0]: None for name in sampled}:
        values = {name: value for name, value in sampled.items() if target(name)[0] == section}
        try:
            result[section] = _with_values(result[section], values)
        except ValidationError as error:
            raise _refusal(error, result[section], values) from error
    return result


def check_ranges(sections: Sections, randomise: Randomise) -> None:
    """Check that each setting can be sampled and that all combinations of range ends are valid."""
    ends: dict[str, dict[str, list[float]]] = {}
    for one in randomise.sampled():
        low, high = _check(one, sections[one.section])
        ends.setdefault(one.section, {})[one.name] = [low] if low == high else [low, high]
    for section, found in ends.items():
        if math.prod(map(len, found.values())) > _MOST:
            raise ConfigError(
                f"randomise: {len(found)} settings of {section} are sampled; at most "
                f"{_MOST.bit_length() - 1} with a range are allowed"
            )
        if (sections[section], found) not in _possible:
            _check_combinations(sections[section], found)
            _possible.append((sections[section], found))


def _check_combinations(settings: Settings, ends: Mapping[str, list[float]]) -> None:
    for combination in product(*ends.values()):
        values = dict(zip(ends, combination, strict=True))
        try:
            _with_values(settings, values)
        except ValidationError as error:
            raise _refusal(error, settings, values) from error


def _check(one: Sampled, settings: Settings) -> tuple[float, float]:
    """Return the ends of the samples of a setting that exists and can be sampled."""
    cls, known = type(settings), sorted({*type(settings).model_fields, *type(settings).factors})
    chosen = f"{one.section}={cls.plugin_name}" if issubclass(cls, Plugin) else one.section
    if one.field not in known:
        raise ConfigError(
            f"{one.key}: {chosen} has no setting {one.field!r}{close_match(one.field, known)}; "
            f"drop it with {one.key}=null"
        )
    kind = _kind(cls, one.field)
    if one.field in cls.not_sampled or kind is None:
        what = "policies rely on it" if kind else "it is neither a number nor a switch"
        names = [n for n in known if n not in cls.not_sampled and _kind(cls, n)]
        raise ConfigError(
            f"{one.key}: {what}, so it cannot be sampled; settings of {chosen} that can be "
            f"sampled: {', '.join(names)}"
        )
    if kind is bool:
        probability = one.value
        if isinstance(probability, tuple) or not 0 <= probability <= 1:
            raise ConfigError(
                f"{one.key}: a probability of {one.section}.{one.field}, 0 to 1, is allowed; the "
                f"value is {probability}"
            )
        return float(probability > 0), float(probability == 1)
    low, high = (_allowed(cls, one.field, end) for end in one.ends)
    return low, high


@lru_cache(maxsize=1000)  # it is called for every combination of range ends
def _kind(cls: type[Settings], field: str) -> type[bool | int | float] | None:
    """Return the type of a setting or factor that can be sampled, None for any other setting."""
    if field in cls.factors:
        return float
    found = set(_types(cls.model_fields[field].annotation)) - {types.NoneType}
    if found == {bool}:
        return bool
    if found == {int}:
        return int
    return float if found in ({float}, {int, float}) else None


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
    cls, values = type(settings), {target(name)[1]: value for name, value in sampled.items()}
    factors = {name: values.pop(name) for name in cls.factors if name in values}
    switched = {name: bool(v) if _kind(cls, name) is bool else v for name, v in values.items()}
    fields = {**dict(settings), **switched}
    for factor, value in factors.items():
        fields |= {name: value * fields[name] for name in cls.factors[factor]}
    return construct(cls, fields) if issubclass(cls, Plugin) else cls(**fields)


def _refusal(error: ValidationError, settings: Settings, values: Mapping[str, float]) -> Exception:
    """Return an error that names the ranges that make the section impossible."""
    first = error.errors()[0]["loc"]
    for name in values:
        if first and first[0] == target(name)[1]:
            where = f"randomise.{name}".rpartition(".")[0]
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
