"""Describe every setting of a configuration: path, value, default, bounds, unit, meaning.

In: frozen settings, plugins among them at any depth. Out: one ``Setting`` for each field.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from enum import Enum
from typing import Any, Literal, get_args, get_origin

from flipperctl.api import Plugin, Robot, Settings, registry
from flipperctl.config import DEFAULT_ENGINE, Randomise, resolver
from flipperctl.config.sampled import SECTIONS
from flipperctl.plugging import guard
from flipperctl.text.messages import bounds, meaning, unit

_CHOICE = "name"
"""The field that names the variant of a section, such as ``local`` for the collector."""


@dataclass(frozen=True)
class Field:
    """A field of a class of settings."""

    name: str
    type: str
    default: Any
    """The default as plain data; None if the field has none."""
    bounds: str
    """Bounds such as ``> 0, ≤ 0.4``, or the allowed values; empty if there are none."""
    unit: str
    """Unit of the value; ``-`` for a dimensionless number, empty if there is no unit."""
    description: str


@dataclass(frozen=True)
class Setting:
    """A field at its place in a configuration, with its value there."""

    section: str
    """Path of the section or plugin that the field belongs to; empty at the top level."""
    path: str
    """Key used by overrides; items of a list, which is overridden as a whole, have ``[i]``."""
    value: Any
    """The value as plain data."""
    field: Field


def fields(cls: type[Settings]) -> list[Field]:
    """Return the fields of a class of settings."""
    # A class with required fields cannot be made at its defaults; each field then has its own.
    complete = not any(info.is_required() for info in cls.model_fields.values())
    defaults, described = {}, []
    if complete:
        defaults = resolver.defaults(cls) if issubclass(cls, Plugin) else _plain(cls())
    for name, info in cls.model_fields.items():
        default = defaults.get(name) if complete or info.is_required() else info.get_default()
        shown = str(getattr(info.annotation, "__name__", info.annotation))
        words = _allowed(cls, name), unit(cls, name), meaning(cls, name)
        described.append(Field(name, shown, default, *words))
    return described


def settings(config: Settings, path: str = "") -> Iterator[Setting]:
    """Yield every setting of ``config``, which is at ``path`` in the whole configuration.

    Its own fields come first, then the settings of sections and plugins inside, at any depth. A
    plugin or a collector begins with a setting that holds its name.
    """
    # Own fields now, the parts inside afterwards
    plain = _plain(config)
    inside: list[tuple[str, Settings]] = []
    for field in fields(type(config)):
        if field.name == _CHOICE and not isinstance(config, Plugin):
            continue  # yielded by ``_choice``
        where, value = f"{path}.{field.name}".lstrip("."), getattr(config, field.name)
        # Paths have the bounds and units of the settings that they sample.
        if isinstance(config, Randomise) and field.name in SECTIONS and value:
            cls = _sampled_from(field.name)
            for name, by_path in plain[field.name].items():
                words = bounds(cls, name), unit(cls, name) or "-", f"of {field.name}.{name}"
                yield Setting(path, f"{where}.{name}", by_path, Field(name, "Range", None, *words))
            continue
        nested = list(_nested(value, where))
        if not nested or isinstance(value, tuple | list):
            yield Setting(path, where, plain.get(field.name, {}), field)
        inside += nested
    for where, part in inside:
        yield from _choice(where, part)
        yield from settings(part, where)


def describe_plugin(kind: str, name: str) -> dict[str, Any]:
    """Return a registered plugin and its fields as plain data."""
    cls = registry[kind, name]
    return {
        "kind": kind,
        "name": name,
        "summary": summary(cls),
        "module": cls.__module__,
        "source": guard.definition(cls),
        "fields": [asdict(field) for field in fields(cls)],
    }


def _nested(value: Any, path: str) -> Iterator[tuple[str, Settings]]:
    """Yield the settings in a field's value, each with its path."""
    if isinstance(value, Settings):
        yield path, value
    elif isinstance(value, Mapping):
        for name, item in value.items():
            yield from _nested(item, f"{path}.{name}")
    elif isinstance(value, tuple | list):
        for index, item in enumerate(value):
            yield from _nested(item, f"{path}[{index}]")


def _choice(path: str, variant: Settings) -> Iterator[Setting]:
    """Yield the setting that names ``chosen``, if it is a plugin or one of several variants."""
    name, kind = getattr(variant, _CHOICE, None), "section"
    if isinstance(variant, Plugin):
        name, kind = variant.plugin_name, f"{variant.kind} plugin"
    if name is not None:
        field = Field(_CHOICE, kind, None, "", "", summary(type(variant)))
        yield Setting(path, path, name, field)


def summary(cls: type[Settings]) -> str:
    """Return the first line of a class's docstring, without literals' backticks."""
    return (cls.__doc__ or "").strip().partition("\n")[0].replace("``", "")


def _allowed(cls: type[Settings], name: str) -> str:
    """Return the bounds of a field, or its allowed values."""
    info = cls.model_fields[name]
    lengths = [getattr(item, "min_length", None) for item in info.metadata]
    least = "".join(f"length ≥ {length}" for length in lengths if length is not None)
    return bounds(cls, name) or ", ".join(_values(info.annotation)) or least


def _sampled_from(section: str) -> type[Settings]:
    """Return the settings of the robot, or of the default engine or sensor."""
    return Robot if section == "robot" else resolver.get(section, DEFAULT_ENGINE, section)


def _values(annotation: Any) -> Iterator[str]:
    """Yield the values of the literals and enumerations in an annotation."""
    if get_origin(annotation) is Literal:
        yield from map(str, get_args(annotation))
    elif isinstance(annotation, type) and issubclass(annotation, Enum):
        yield from (str(member.value) for member in annotation)
    else:
        for inner in get_args(annotation):
            yield from _values(inner)


def _plain(config: Settings) -> dict[str, Any]:
    if isinstance(config, Plugin):
        return resolver.to_dict(config, brief=True)
    return config.model_dump(mode="json", context={"brief": True})
