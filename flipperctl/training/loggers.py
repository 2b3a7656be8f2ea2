"""The loggers of a training, none of which can stop it.

In: the plugins of a configuration. Out: listeners of the trainer. One that fails is dropped after a
warning on stderr.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from flipperctl import guard
from flipperctl.api import Listener, Logger, RunInfo
from flipperctl.config import TrainConfig, container
from flipperctl.errors import MissingExtraError


def openers(
    config: TrainConfig, directory: Path, resume_at: int | None
) -> list[Callable[[], Listener]]:
    """Return a function for each logger that opens it for the run in ``directory``.

    ``resume_at``: decision from which the run goes on; None if it begins. The functions raise
    MissingExtraError if a package that the logger needs is not installed.
    """
    plain = container(config)

    def opener(key: str, logger: Logger) -> Callable[[], Listener]:
        return lambda: GuardedLogger(logger, RunInfo(directory, directory / key, plain, resume_at))

    return [opener(key, logger) for key, logger in config.logger.items()]


class GuardedLogger:
    """Passes everything on to a logger's listener, until that fails."""

    def __init__(self, logger: Logger, run: RunInfo) -> None:
        """Open the logger.

        Raises:
            MissingExtraError: a package that it needs is not installed.
        """
        self._logger = logger
        self._listener: Listener | None = None
        try:
            self._listener = logger.open(run)
        except ImportError as error:
            raise MissingExtraError(f"logger={logger.plugin_name}: {error}") from error
        except BaseException as error:  # noqa: BLE001  # a plugin's own code may raise anything
            self._drop(error, "open")

    def episode(self, row: Mapping[str, Any]) -> None:
        """Record a training episode that ended."""
        self._attempt("episode", lambda listener: listener.episode(row))

    def validation(self, row: Mapping[str, Any]) -> None:
        """Record a validation."""
        self._attempt("validation", lambda listener: listener.validation(row))

    def note(self, text: str) -> None:
        """Record an event that the user should know."""
        self._attempt("note", lambda listener: listener.note(text))

    def close(self) -> None:
        """Close the listener, unless it was dropped."""
        self._attempt("close", lambda listener: listener.close())

    def _attempt(self, method: str, call: Callable[[Listener], None]) -> None:
        if self._listener is None:
            return
        try:
            call(self._listener)
        except BaseException as error:  # noqa: BLE001  # a plugin's own code may raise anything
            self._drop(error, method)

    def _drop(self, error: BaseException, method: str) -> None:
        """Warn, and use the listener no more; an interrupt is raised again."""
        if isinstance(error, KeyboardInterrupt):
            raise error
        listener, self._listener = self._listener, None
        if listener is not None and method != "close":
            with contextlib.suppress(Exception):
                listener.close()
        where = guard.error_place(error, self._logger, method)
        print(
            f"warning: {guard.plugin_label(self._logger)}: {method} raised "
            f"{guard.error_line(error)} ({where}); the training goes on without it",
            file=sys.stderr,
        )
