"""Measures: one number for each episode, shown in rows, tables, files and comparisons."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar, Literal, TypeVar

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


def measure(name: str) -> Callable[[type[MeasureT]], type[MeasureT]]:
    """Register a ``Measure``; ``name`` is its column in files and its key in JSON.

    Raises:
        ValueError: the name is not valid or is already taken.
        TypeError: the class is not a ``Measure``, or has settings.
    """
    registered = register(Measure, name)

    def decorate(cls: type[MeasureT]) -> type[MeasureT]:
        if fields := list(getattr(cls, "model_fields", ())):
            raise TypeError(
                f"@measure({name!r}): {cls.__name__} has the settings {', '.join(fields)}; every "
                "measure is computed for every episode, so it takes no settings: use ClassVar"
            )
        return registered(cls)

    return decorate
