"""Measures: one number for each episode, shown in rows, tables, files and comparisons."""

from __future__ import annotations

import functools
import types
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Literal, Protocol, TypeVar, overload

from flipperctl.api.plugin import Plugin, register
from flipperctl.api.values import Transition


class Measure(Plugin, ABC):
    """One number for each episode; every registered measure is computed for every episode.

    It appears in the rows of training and evaluation, in validations, and with its mean and
    interval in tables, JSON and paired comparisons. It has no settings.
    """

    kind: ClassVar[str] = "measure"
    unit: ClassVar[str] = "-"
    """Unit of the value, as tables show it."""
    digits: ClassVar[int] = 2
    """Number of decimals in tables."""
    reached_only: ClassVar[bool] = False
    """Whether only episodes that reached the finish are compared, as for a duration."""
    mapped_only: ClassVar[bool] = False
    """Whether only episodes whose sensor maps the ground have it (``Perception.seen`` is not None).
    Such a measure is shown in evaluations with such a sensor, and no training logs it."""
    better: ClassVar[Literal["lower", "higher"] | None] = None
    """Which values are better, as stated in tables of differences; None: neither."""
    in_tables: ClassVar[bool] = True
    """Whether printed tables and ``table.tex`` have a column; files and JSON always have one."""

    @abstractmethod
    def __call__(self, episode: Sequence[Transition]) -> float:
        """Return the value of a whole episode, of one decision or more, in ``unit``."""


MeasureT = TypeVar("MeasureT", bound=Measure)
Function = Callable[[Sequence[Transition]], float]
"""A measure as a function of a whole episode; its docstring describes it."""


class _Decorator(Protocol):
    @overload
    def __call__(self, written: type[MeasureT], /) -> type[MeasureT]: ...

    @overload
    def __call__(self, written: Function, /) -> type[Measure]: ...


def measure(
    name: str,
    *,
    unit: str = "-",
    digits: int = 2,
    reached_only: bool = False,
    mapped_only: bool = False,
    better: Literal["lower", "higher"] | None = None,
    in_tables: bool = True,
) -> _Decorator:
    """Register a function of an episode as a ``Measure``, or a class of its own.

    ``name`` is its column in files and its key in JSON. The other arguments describe a function's
    values as the attributes of ``Measure`` by their names do; a class has these attributes itself.

    Raises:
        ValueError: the name is not valid or is already taken.
        TypeError: the class is not a ``Measure``, or has settings.
    """
    registered = register(Measure, name)
    described = {
        "unit": unit,
        "digits": digits,
        "reached_only": reached_only,
        "mapped_only": mapped_only,
        "better": better,
        "in_tables": in_tables,
    }

    def decorate(written: Any, /) -> Any:
        cls = written if isinstance(written, type) else _class_of(written, described)
        if fields := list(getattr(cls, "model_fields", ())):
            raise TypeError(
                f"@measure({name!r}): {cls.__name__} has the settings {', '.join(fields)}; every "
                "measure is computed for every episode, so it takes no settings: use ClassVar"
            )
        return registered(cls)

    return decorate


def _class_of(function: Function, described: dict[str, object]) -> type[Measure]:
    @functools.wraps(function)
    def call(self: Measure, episode: Sequence[Transition]) -> float:
        return function(episode)

    named = {key: getattr(function, key) for key in ("__doc__", "__module__", "__qualname__")}
    body = {**named, **described, "__call__": call}
    return types.new_class(function.__name__, (Measure,), exec_body=lambda ns: ns.update(body))
