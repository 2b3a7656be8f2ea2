"""Loggers, which record a training in addition to ``metrics.csv``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from flipperctl.api.plugin import Plugin, register

_COUNTS = ("decision", "episode", "seed")
"""Columns that identify a row and measure nothing."""


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
