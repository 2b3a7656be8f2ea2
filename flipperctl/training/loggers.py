"""The loggers of a training, which can never stop it.

In: the plugins of a configuration. Out: listeners of the trainer. A listener that fails is dropped
with a warning on stderr.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from flipperctl import guard
from flipperctl.api import Listener, Logger, RunInfo
from flipperctl.config import TrainConfig, to_dict
from flipperctl.errors import MissingExtraError


def openers(
    config: TrainConfig, directory: Path, resume_at: int | None
) -> list[Callable[[], Listener]]:
    """Return for each logger a function that opens it for the run in ``directory``.

    ``resume_at``: decision from which the run continues; None for a new run. The functions raise
    MissingExtraError if a package that the logger needs is not installed.
    """
    plain = to_dict(config)

    def opener(key: str, logger: Logger) -> Callable[[], Listener]:
        return lambda: GuardedLogger(logger, RunInfo(directory, directory / key, plain, resume_at))

    return [opener(key, logger) for key, logger in config.logger.items()]


class GuardedLogger:
    """Forwards all events to a logger's listener until the listener fails."""

    def __init__(self, logger: Logger, run: RunInfo) -> None:
        """Open the logger.

        Raises:
            MissingExtraError: a package that the logger needs is not installed.
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
        """Record the row of an ended training episode."""
        self._attempt("episode", lambda listener: listener.episode(row))

    def validation(self, row: Mapping[str, Any]) -> None:
        """Record the row of a validation."""
        self._attempt("validation", lambda listener: listener.validation(row))

    def note(self, text: str) -> None:
        """Record a message for the user."""
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
        """Warn and drop the listener; an interrupt is raised again."""
        if isinstance(error, KeyboardInterrupt):
            raise error
        listener, self._listener = self._listener, None
        if listener is not None and method != "close":
            with contextlib.suppress(Exception):
                listener.close()
        where = guard.error_place(error, self._logger, method)
        print(
            f"warning: {guard.plugin_label(self._logger)}: {method} raised "
            f"{guard.error_line(error)} ({where}); the training continues without it",
            file=sys.stderr,
        )
