"""What is recorded: measures, one number for each episode, and loggers, which follow a training."""

from __future__ import annotations

import functools
import types
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, TypeVar, overload

from flipperctl.api.plugin import Plugin, register
from flipperctl.api.values import Transition

_COUNTS = ("decision", "episode", "seed")
"""Columns that identify a row and measure nothing."""


class Measure(Plugin, ABC):
    """One number for each episode; every registered measure is computed for every episode.

    It appears in the rows of training and evaluation, in validations, and with its mean and
    interval in tables, JSON and paired comparisons. It has no settings.
    """

    kind: ClassVar[str] = "measure"
    # How it is shown.
    unit: ClassVar[str] = "-"
    """Unit of the value, as tables show it."""
    digits: ClassVar[int] = 2
    """Number of decimals in tables."""
    # Which episodes have it.
    reached_only: ClassVar[bool] = False
    """Whether only episodes that reached the finish are compared, as for a duration."""
    mapped_only: ClassVar[bool] = False
    """Whether only episodes whose sensor maps the ground have it (``Perception.seen`` is not None).
    Such a measure is shown in evaluations with such a sensor, and no training logs it."""
    operated_only: ClassVar[bool] = False
    """Whether only episodes of an operator have it (``Transition.commands`` is not None); no
    training logs it."""
    rolled_only: ClassVar[bool] = False
    """Whether only episodes in 3-D have it (``Transition.roll_variation`` is not None)."""
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
    operated_only: bool = False,
    rolled_only: bool = False,
    better: Literal["lower", "higher"] | None = None,
    in_tables: bool = True,
) -> _Decorator:
    """Register a ``Measure``: a class, or a function of an episode.

    ``name`` is its column in files and its key in JSON. The other arguments describe a function's
    values as the attributes of ``Measure`` by their names do; a class has these attributes itself.

    Raises:
        ValueError: the name is not valid or is already taken.
        TypeError: the class is not a ``Measure``, or has settings.
    """
    registered = register(Measure, name, _check_no_settings)
    described = {
        "unit": unit,
        "digits": digits,
        "better": better,
        "in_tables": in_tables,
        "reached_only": reached_only,
        "mapped_only": mapped_only,
        "operated_only": operated_only,
        "rolled_only": rolled_only,
    }

    def decorate(written: Any, /) -> Any:
        return registered(written if isinstance(written, type) else _class_of(written, described))

    return decorate


def _check_no_settings(cls: type[Measure], where: str) -> None:
    if fields := list(cls.model_fields):
        raise TypeError(
            f"{where}: {cls.__name__} has the settings {', '.join(fields)}; every measure is "
            "computed for every episode, so it takes no settings: use ClassVar"
        )


def _class_of(function: Function, described: Mapping[str, object]) -> type[Measure]:
    @functools.wraps(function)
    def call(self: Measure, episode: Sequence[Transition]) -> float:
        return function(episode)

    # Name, place and docstring of the function become those of the class, for errors and help.
    named = {key: getattr(function, key) for key in ("__doc__", "__module__", "__qualname__")}
    body = {**named, **described, "__call__": call}
    return types.new_class(function.__name__, (Measure,), exec_body=lambda ns: ns.update(body))


class Listener(Protocol):
    """Receives every finished episode, every validation and every note for the user.

    A row maps the columns of ``metrics.csv`` to values; ``decision`` is the step to record it at.
    """

    def episode(self, row: Mapping[str, Any]) -> None:
        """Record a finished training episode."""

    def validation(self, row: Mapping[str, Any]) -> None:
        """Record a validation."""

    def note(self, text: str) -> None:
        """Record an event that the user should know, as a sentence."""

    def close(self) -> None:
        """Release resources; called once, even if the run failed."""


@dataclass(frozen=True)
class RunInfo:
    """The training run that a logger records."""

    directory: Path
    """The run directory."""
    folder: Path
    """Folder within it for the logger's own files; the logger creates it."""
    config: Mapping[str, Any]
    """The whole configuration as plain data, as in ``config.yaml``."""
    resume_at: int | None
    """Decision at which the run resumes; records of later decisions are void. None: a new run."""


class Logger(Plugin, ABC):
    """Records trainings. A logger that fails is dropped with a warning; the training continues."""

    kind: ClassVar[str] = "logger"
    remote: ClassVar[bool] = False
    """Whether it sends values to another machine; the conformance suite then does not open it."""

    @abstractmethod
    def open(self, run: RunInfo) -> Listener:
        """Begin or resume the record of a run.

        The listener is called in the learning thread, so its methods should return quickly.

        Raises:
            ImportError: a package is not installed; the text says how to install it. The training
                then does not begin.
        """


LoggerT = TypeVar("LoggerT", bound=Logger)


def logger(name: str) -> Callable[[type[LoggerT]], type[LoggerT]]:
    """Register a ``Logger``; choose it with ``logger=<name>``, several with ``logger=[a,b]``."""
    return register(Logger, name)


def scalars(group: str, row: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers of a row by the names common to all loggers, such as ``episode/return``.

    ``group``: ``episode`` or ``validation``.
    """
    numbers = {k: v for k, v in row.items() if isinstance(v, int | float) and k not in _COUNTS}
    return {f"{group}/{name}": value for name, value in numbers.items()}
