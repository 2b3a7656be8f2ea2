"""Variants of a plugin: its defaults and the outermost values of each field.

In: a plugin's class. Out: instances, each labelled with the setting that differs.
"""

from __future__ import annotations

import math
import types
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import ValidationError

from flipperctl.api import Plugin
from flipperctl.errors import ConformanceError

_CONTRACT = Plugin.__module__.rpartition(".")[0] + "."
"""Package of the families' base classes."""
_BOUNDS = {"ge": 0, "le": 0, "gt": 1, "lt": -1}
"""Kind of bound → direction from the bound to the nearest allowed value [-]."""


@dataclass(frozen=True)
class Variant:
    """A plugin, labelled with the setting that differs from its defaults."""

    label: str
    plugin: Plugin


def at_defaults(cls: type[Plugin]) -> Variant:
    """Return the plugin that its name alone creates.

    Raises:
        ConformanceError: a field has no default, or the defaults are not valid.
    """
    try:
        return Variant("its defaults", cls())
    except ValidationError as error:
        raise ConformanceError(f"with its defaults: {_found(error)}") from error


def variants(cls: type[Plugin]) -> list[Variant]:
    """Return the defaults, then each bound and each choice of each of the plugin's own fields.

    Values that the plugin's validator rejects with other fields at their defaults are left out.

    Raises:
        ConformanceError: a field's type rejects a value that its bounds allow.
    """
    found = [at_defaults(cls)]
    default = found[0].plugin
    for field in own_fields(cls):
        for value in edges(cls, field):
            if value == getattr(default, field):
                continue
            label = f"{field}={value}"
            try:
                found.append(Variant(label, cls(**{field: value})))
            except ValidationError as error:
                if error.errors()[0]["type"] != "value_error":
                    raise ConformanceError(f"with {label}: {_found(error)}") from error
    return found


def own_fields(cls: type[Plugin]) -> list[str]:
    """Return the fields that the plugin adds to those of its kind's base classes."""
    shared: set[str] = set()
    for base in cls.__mro__[1:]:
        if base.__module__.startswith(_CONTRACT):
            shared |= set(getattr(base, "model_fields", {}))
    return [name for name in cls.model_fields if name not in shared]


def edges(cls: type[Plugin], field: str) -> Iterator[Any]:
    """Yield the outermost values that a field's bounds allow, or its choices."""
    info = cls.model_fields[field]
    kinds = numbers(info.annotation)
    for bound in info.metadata:
        for name, direction in _BOUNDS.items():
            value = getattr(bound, name, None)
            if value is None:
                continue
            if kinds == {int}:
                yield int(value) + direction
            else:
                yield math.nextafter(value, math.inf * direction) if direction else value
    if info.annotation is bool:
        yield from (False, True)
    elif get_origin(info.annotation) is Literal:
        yield from get_args(info.annotation)


def numbers(annotation: Any) -> set[type]:
    """Return the number types, ``int`` or ``float``, in a field's annotation or union."""
    union = get_origin(annotation) in (Union, types.UnionType)
    parts = get_args(annotation) if union else (annotation,)
    return {part for part in parts if part in (int, float)}


def _found(error: ValidationError) -> str:
    first = error.errors()[0]
    where = ".".join(map(str, first["loc"]))
    return f"{where + ': ' if where else ''}{first['msg']}; the value is {first['input']!r}"
