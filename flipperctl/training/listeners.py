"""What watches a training: ``metrics.csv``, the plugins of its loggers, and its time.

The writer of ``metrics.csv`` is a listener of the trainer; a resumed run continues the file from
its checkpoint. A logger that fails is dropped with a warning on stderr. The time is in
``timing.json``, separate from the checkpoints, so that equal runs have equal checkpoint files.
"""

from __future__ import annotations

import contextlib
import csv
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from flipperctl import guard
from flipperctl.api import Listener, Logger, RunInfo
from flipperctl.config import TrainConfig, to_dict
from flipperctl.env.metrics import logged
from flipperctl.errors import CheckpointError, MissingExtraError, WriteError
from flipperctl.files import failure, write_csv, write_json
from flipperctl.show import print_text


def columns() -> tuple[str, ...]:
    """Return the columns that every ``metrics.csv`` has."""
    named = [name for name in logged() if name != "decisions"]
    return (
        *("kind", "decision", "episode", "seed", "terrain", "difficulty", "outcome"),
        *("success_rate", "decisions", "return", *named),
        *("start_shift", "start_front", "start_rear", "epsilon", "loss", "lag", "seconds"),
        "mean_return",
    )


class MetricsCsv:
    """Writes one row for each episode and each validation; the column ``kind`` tells which."""

    def __init__(
        self,
        path: Path,
        terms: Sequence[str],
        randomised: Sequence[str] = (),
        resume_at: int | None = None,
    ) -> None:
        """``terms``: names of the reward terms; ``randomised``: names of the randomised settings.

        ``resume_at``: decision after which the rows of an existing file are dropped; None begins a
        new file.
        """
        self._columns = [*columns(), *randomised, *(f"reward_{term}" for term in terms)]
        kept: list[Mapping[str, Any]] = []
        if resume_at is not None and path.is_file():
            complete = [row for row in read_rows(path) if None not in row.values()]  # not cut off
            numbered = [row for row in complete if row.get("decision", "").isdigit()]
            kept = [row for row in numbered if int(row["decision"]) <= resume_at]
        write_csv(path, kept, self._columns)
        self._path = path
        self._file = path.open("a", encoding="utf-8", newline="", buffering=1)
        self._writer = csv.DictWriter(self._file, self._columns, extrasaction="ignore")

    def episode(self, row: Mapping[str, Any]) -> None:
        """Append the row of an episode."""
        self._write({"kind": "episode", **row})

    def validation(self, row: Mapping[str, Any]) -> None:
        """Append the row of a validation: means over its episodes."""
        self._write({"kind": "validation", **row})

    def note(self, text: str) -> None:
        """Ignore notes; the file has no row for them."""

    def _write(self, row: Mapping[str, Any]) -> None:
        if not self._path.exists():  # rows would go to a deleted file
            raise WriteError(f"{self._path} was deleted while the run was training")
        try:
            self._writer.writerow(row)
        except OSError as error:
            raise failure(self._path, error) from error

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a ``metrics.csv`` as text by column name."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))
    except (UnicodeDecodeError, csv.Error) as error:
        raise CheckpointError(
            f"{path} is damaged ({error}); without this file the run goes on, and has no earlier "
            "rows"
        ) from error


def openers(
    config: TrainConfig, directory: Path, resume_at: int | None
) -> list[Callable[[], Listener]]:
    """Return for each logger a function that opens it for the run in ``directory``.

    ``resume_at``: decision from which the run continues; None for a new run.
    """
    plain = to_dict(config)
    return [
        partial(GuardedLogger, logger, RunInfo(directory, directory / key, plain, resume_at))
        for key, logger in config.logger.items()
    ]


class GuardedLogger:
    """Forwards all events to a logger's listener until the listener fails."""

    def __init__(self, logger: Logger, run: RunInfo) -> None:
        """Open the logger."""
        self._logger = logger
        self._listener: Listener | None = None
        try:
            self._listener = logger.open(run)
        except ImportError as error:
            raise MissingExtraError(f"logger={logger.plugin_name}: {error}") from error
        except BaseException as error:  # noqa: BLE001  # a plugin's own code may raise anything
            self._drop(error, "open")

    def episode(self, row: Mapping[str, Any]) -> None:
        """Record the row of a training episode."""
        self._attempt("episode", row)

    def validation(self, row: Mapping[str, Any]) -> None:
        """Record the row of a validation."""
        self._attempt("validation", row)

    def note(self, text: str) -> None:
        """Record a message for the user."""
        self._attempt("note", text)

    def close(self) -> None:
        """Close the listener, unless it was dropped."""
        self._attempt("close")

    def _attempt(self, method: str, *arguments: Any) -> None:
        try:
            if self._listener is not None:
                getattr(self._listener, method)(*arguments)
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
        print_text(
            f"warning: {guard.plugin_label(self._logger)}: {method} raised "
            f"{guard.error_line(error)} ({where}); the training continues without it",
            stderr=True,
        )


NAME = "timing.json"


class Stopwatch:
    """Measures the time of a run over all its starts."""

    def __init__(self, directory: Path) -> None:
        self._path = directory / NAME
        self._earlier = 0.0
        self._started_at = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Time that the run has taken so far [s]."""
        return self._earlier + time.perf_counter() - self._started_at

    def start(self) -> None:
        """Start counting, on top of the time from ``read``."""
        self._started_at = time.perf_counter()

    def write(self) -> None:
        """Write the time so far to ``timing.json``."""
        write_json(self._path, {"seconds": round(self.seconds, 3)})

    def read(self) -> None:
        """Read the time at the last checkpoint, without which a run resumes, too."""
        try:
            seconds = json.loads(self._path.read_text(encoding="utf-8"))["seconds"]
        except (OSError, ValueError, RecursionError, LookupError, TypeError):
            return
        if isinstance(seconds, int | float) and math.isfinite(seconds) and seconds >= 0:
            self._earlier = float(seconds)
