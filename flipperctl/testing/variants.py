"""A plugin at its defaults and at the outermost values of each of its fields.

In: a plugin's class. Out: instances, each with the settings that make it differ.
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


@dataclass(frozen=True)
class Variant:
    """A plugin, and the setting that differs from its defaults."""

    label: str
    plugin: Plugin


def at_defaults(cls: type[Plugin]) -> Variant:
    """The plugin as ``flipperctl`` makes it when only its name is given.

    Raises:
        ConformanceError: a field has no default, or the defaults are not valid.
    """
    try:
        return Variant("its defaults", cls())
    except ValidationError as error:
        raise ConformanceError(f"with its defaults: {_found(error)}") from error


def variants(cls: type[Plugin]) -> list[Variant]:
    """Its defaults, then each bound and each choice of each field of its own.

    A value that does not go with the other fields' defaults (a validator says so) gives none.

    Raises:
        ConformanceError: a value that a field's own bounds allow is refused by its type.
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
    """The fields that are not those of its whole family."""
    shared: set[str] = set()
    for base in cls.__mro__[1:]:
        if base.__module__.startswith(_CONTRACT):
            shared |= set(getattr(base, "model_fields", {}))
    return [name for name in cls.model_fields if name not in shared]


def edges(cls: type[Plugin], field: str) -> Iterator[Any]:
    """The outermost values that a field's bounds allow, or its choices."""
    info = cls.model_fields[field]
    kinds = numbers(info.annotation)
    for bound in info.metadata:
        for name, way in _BOUNDS.items():
            value = getattr(bound, name, None)
            if value is None:
                continue
            if kinds == {int}:
                yield int(value) + way
            else:
                yield math.nextafter(value, math.inf * way) if way else value
    if info.annotation is bool:
        yield from (False, True)
    elif get_origin(info.annotation) is Literal:
        yield from get_args(info.annotation)


def numbers(annotation: Any) -> set[type]:
    """``int`` and ``float``, as far as a field holds one by itself (or None)."""
    union = get_origin(annotation) in (Union, types.UnionType)
    parts = get_args(annotation) if union else (annotation,)
    return {part for part in parts if part in (int, float)}


def _found(error: ValidationError) -> str:
    first = error.errors()[0]
    where = ".".join(map(str, first["loc"]))
    return f"{where + ': ' if where else ''}{first['msg']}; the value is {first['input']!r}"
