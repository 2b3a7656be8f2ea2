"""Sections of a configuration with sampled values, validated like every other setting.

In: the sections ``sim``, ``robot`` and ``perception``, and sampled values or the ranges of these.
Out: the sections of one episode, or an error before any episode if some would be impossible.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import product
from typing import Any

from pydantic import ValidationError

from flipperctl.api import Plugin, Settings
from flipperctl.config.randomise import SECTION_OF, SWITCHES, Randomise, fitting
from flipperctl.config.resolver import construct
from flipperctl.errors import ConfigError
from flipperctl.messages import explain

Sections = Mapping[str, Settings]
"""Section's name → its settings."""


def replace_settings(sections: Sections, sampled: Mapping[str, float]) -> dict[str, Any]:
    """Return the sections with the sampled values in place of their own.

    Raises:
        ConfigError: the values are not possible together.
    """
    result = dict(sections)
    for section in {_section(name): None for name in sampled}:
        values = {name: value for name, value in sampled.items() if _section(name) == section}
        try:
            result[section] = _with_values(result[section], values)
        except ValidationError as error:
            raise _refusal(error, result[section], values) from error
    return result


def check_ranges(sections: Sections, randomise: Randomise) -> None:
    """Check that every combination of the ranges' ends is possible.

    Raises:
        ConfigError: one is not, or a section has no such setting; the text names the ranges.
    """
    ends: dict[str, dict[str, Iterable[float]]] = {}
    for section, name, limits in randomise.ranges():
        ends.setdefault(section, {})[name] = {fitting(name, limit) for limit in limits}
    for section, name, probability in randomise.probabilities():
        ends.setdefault(section, {})[name] = {float(probability > 0), float(probability == 1)}
    for section, found in ends.items():
        settings = sections[section]
        for name in found:
            if name not in type(settings).model_fields:
                raise ConfigError(
                    f"randomise.{name}: {section}={getattr(settings, 'plugin_name', '')} has no "
                    f"setting {name!r}; drop it with randomise.{name}=null"
                )
        for combination in product(*found.values()):
            values = dict(zip(found, combination, strict=True))
            try:
                _with_values(settings, values)
            except ValidationError as error:
                raise _refusal(error, settings, values) from error


def _section(name: str) -> str:
    return SWITCHES[name] if name in SWITCHES else SECTION_OF[name]


def _with_values(settings: Settings, sampled: Mapping[str, float]) -> Settings:
    """Return the settings with the sampled values.

    Raises:
        ValidationError: the values are not possible.
    """
    values = {name: bool(v) if name in SWITCHES else v for name, v in sampled.items()}
    fields, cls = {**dict(settings), **values}, type(settings)
    return construct(cls, fields) if issubclass(cls, Plugin) else cls(**fields)


def _refusal(error: ValidationError, settings: Settings, values: Mapping[str, float]) -> Exception:
    """Return the error that names the ranges without which the section would be possible."""
    first = error.errors()[0]["loc"]
    if first and first[0] in values:
        return ConfigError(explain(error, "randomise", type(settings)))
    to_blame = [name for name in values if _possible_without(name, settings, values)]
    where = ", ".join(f"randomise.{name}" for name in to_blame or values)
    return ConfigError(explain(error, where, type(settings)))


def _possible_without(name: str, settings: Settings, values: Mapping[str, float]) -> bool:
    others = {other: value for other, value in values.items() if other != name}
    try:
        _with_values(settings, others)
    except ValidationError:
        return False
    return True
