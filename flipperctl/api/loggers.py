"""Loggers, which record a training beside ``metrics.csv``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from flipperctl.api.plugin import Plugin, register

_COUNTS = ("decision", "episode", "seed")
"""Columns that say which row it is, and measure nothing."""


class Listener(Protocol):
    """Receives every episode that ends, every validation and every note for the user.

    A row has the columns of ``metrics.csv`` by name; ``decision`` is the step to record it at.
    """

    def episode(self, row: Mapping[str, Any]) -> None:
        """Record a training episode that ended."""

    def validation(self, row: Mapping[str, Any]) -> None:
        """Record a validation."""

    def note(self, text: str) -> None:
        """Record an event that the user should know, as a sentence."""

    def close(self) -> None:
        """Release resources; called once, also when the run failed."""


@dataclass(frozen=True)
class RunInfo:
    """The training run that a logger records."""

    directory: Path
    """The run directory."""
    folder: Path
    """Folder within it for the logger's own files; the logger makes it."""
    config: Mapping[str, Any]
    """The whole configuration as plain data, as in ``config.yaml``."""
    resume_at: int | None
    """Decision from which the run goes on, after which earlier records are void; None if new."""


class Logger(Plugin, ABC):
    """Records trainings. One that fails is dropped with a warning, and the training goes on."""

    kind: ClassVar[str] = "logger"
    remote: ClassVar[bool] = False
    """Whether it sends values to another machine; the conformance suite then does not open it."""

    @abstractmethod
    def open(self, run: RunInfo) -> Listener:
        """Begin the record of a run, or go on with it.

        The listener is called in the thread that learns, so that it should return at once.

        Raises:
            ImportError: a package is not installed; the text says how to install it. The training
                is refused before it begins.
        """


LoggerT = TypeVar("LoggerT", bound=Logger)


def logger(name: str) -> Callable[[type[LoggerT]], type[LoggerT]]:
    """Register a ``Logger``; choose it with ``logger=<name>``, several with ``logger=[a,b]``."""
    return register(Logger, name)


def scalars(group: str, row: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers of a row by the names that loggers share, such as ``episode/return``.

    ``group``: ``episode`` or ``validation``.
    """
    numbers = {k: v for k, v in row.items() if isinstance(v, int | float) and k not in _COUNTS}
    return {f"{group}/{name}": value for name, value in numbers.items()}
