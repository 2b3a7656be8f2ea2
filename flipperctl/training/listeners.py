"""What watches a training: ``metrics.csv``, the plugins of its loggers, and its time.

The writer of ``metrics.csv`` is a listener of the trainer; a resumed run continues the file from
its checkpoint. A logger that fails is dropped with a warning on stderr. What a checkpoint states of
the time, and of ``metrics.csv``, which has times, is in ``timing.json``, separate from the
checkpoints, so that equal runs have equal checkpoint files.
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import os
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import Field

from flipperctl.api import Listener, Logger, RunInfo
from flipperctl.checkpoint.document import Count, Label, NonNegative, Record
from flipperctl.checkpoint.results import names as numbered
from flipperctl.config import TrainConfig, to_dict
from flipperctl.env.metrics import logged
from flipperctl.errors import CheckpointError, MissingExtraError, WriteError
from flipperctl.plugging import guard
from flipperctl.text.files import failure, write_bytes, write_json


def columns() -> tuple[str, ...]:
    """Return the columns that every ``metrics.csv`` has."""
    named = [name for name in logged() if name != "decisions"]
    return (
        "kind",
        "decision",
        "episode",
        "seed",
        "terrain",
        "difficulty",
        "outcome",
        "success_rate",
        "decisions",
        "return",
        *named,
        "start_shift",
        "start_front",
        "start_rear",
        "epsilon",
        "loss",
        "lag",
        "seconds",
        "mean_return",
    )


class Mark(Record):
    """What a checkpoint states of ``metrics.csv``: the rows that the run had written."""

    length: Count
    """[bytes]."""
    sha256: Label
    """Of these bytes."""


class MetricsCsv:
    """Appends one row for each episode and each validation; the column ``kind`` tells which."""

    def __init__(
        self,
        path: Path,
        terms: Sequence[str],
        randomised: Sequence[str] = (),
        rows: int = 0,
        mark: Mark | None = None,
        tell: Callable[[str], None] = lambda text: None,
    ) -> None:
        """``terms``: names of the reward terms; ``randomised``: names of the randomised settings.

        ``rows``: number of rows that a resumed run had written at its checkpoint, and ``mark`` what
        that states of the file, which is cut there. ``tell`` is called with a line if the file is
        not that of an uninterrupted run.

        Raises:
            CheckpointError: the file is not that of the run up to its checkpoint; it is kept.
        """
        names = [*columns(), *randomised, *(f"reward_{term}" for term in terms)]
        begun = _line(names)
        # A resumed run cuts the file at its checkpoint, and goes on with the columns that it has.
        if path.exists() and (rows or mark):
            begun = _verified(path, begun, rows, mark, tell)
            names_there = next(csv.reader([begun.partition(b"\n")[0].decode()]))
            if missing := [name for name in names if name not in names_there]:
                tell(f"{path} goes on with its columns, which lack {', '.join(missing)}")
            names = names_there
        elif rows:
            tell(f"there is no {path}; a new one begins with the rows from here on")
        elif path.exists() and _content(path) != begun:
            place = next(place for place in numbered(path, numbered=True) if not place.exists())
            path.rename(place)
            tell(f"{path} has rows of an earlier start; it is kept as {place.name}")
        if not path.exists():
            write_bytes(path, begun)
        self._path, self._columns = path, names
        # The marks of checkpoints need the length and the digest of all rows so far.
        self._length, self._digest = len(begun), hashlib.sha256(begun)
        self._file = path.open("ab")

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
        line = _line([row.get(name) for name in self._columns])
        try:
            self._file.write(line)
            self._file.flush()
        except OSError as error:
            raise failure(self._path, error) from error
        self._length += len(line)
        self._digest.update(line)

    def mark(self) -> Mark:
        """Return where the file ends now, once the disk has it."""
        os.fsync(self._file.fileno())
        return Mark(length=self._length, sha256=self._digest.hexdigest())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _line(cells: Sequence[Any]) -> bytes:
    text = io.StringIO()
    csv.writer(text).writerow(cells)
    return text.getvalue().encode()


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:  # such as of a folder
        raise failure(path, error) from error


def _verified(
    path: Path, header: bytes, rows: int, mark: Mark | None, tell: Callable[[str], None]
) -> bytes:
    """Cut the file at the end of the ``rows`` of a checkpoint; return what it holds then.

    A checkpoint of an earlier version has no mark: nothing is cut, so that the file must have the
    rows of the run and no others.
    """
    content = _content(path)
    counted = content if mark is None else content[: mark.length]
    if mark is None:
        rows_there = content.count(b"\n") - 1
        whole = content.startswith(header) and content.endswith(b"\n") and rows_there == rows
        fault = f"has other columns or rows than the {rows} rows of the run up to its checkpoint"
    elif len(counted) < mark.length:
        whole, fault = False, f"has {len(counted):,} of the {mark.length:,} bytes of the run's rows"
    else:
        whole = hashlib.sha256(counted).hexdigest() == mark.sha256
        fault = f"was changed within the {mark.length:,} bytes of the run's rows"
    if not whole:
        raise CheckpointError(
            f"{path} {fault}, and is kept; restore it, or move it away: the run then goes on with "
            "a new one"
        )
    # What was written after the checkpoint is played and written again.
    if cut := content[len(counted) :].count(b"\n"):
        tell(f"{path}: {cut} lines after the checkpoint are cut; the run repeats their episodes")
    os.truncate(path, len(counted))
    return counted


def openers(
    config: TrainConfig, directory: Path, resume_at: int | None, warn: Callable[[str], None]
) -> list[Callable[[], Listener]]:
    """Return for each logger a function that opens it for the run in ``directory``.

    ``resume_at``: decision from which the run continues; None for a new run. ``warn`` is called
    with a line if a logger fails and is dropped.
    """
    plain = to_dict(config)
    return [
        partial(GuardedLogger, logger, RunInfo(directory, directory / key, plain, resume_at), warn)
        for key, logger in config.logger.items()
    ]


class GuardedLogger:
    """Forwards all events to a logger's listener until the listener fails."""

    def __init__(self, logger: Logger, run: RunInfo, warn: Callable[[str], None]) -> None:
        """Open the logger."""
        self._logger, self._warn = logger, warn
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
        # Forget the listener first: closing it may fail as well.
        listener, self._listener = self._listener, None
        if listener is not None and method != "close":
            with contextlib.suppress(Exception):
                listener.close()
        where = guard.place(error) or guard.definition(self._logger, method)
        self._warn(
            f"warning: {guard.plugin_label(self._logger)}: {method} raised "
            f"{guard.error_line(error)} ({where}); the training continues without it"
        )


NAME = "timing.json"


class _Stated(Record):
    """The contents of ``timing.json``."""

    seconds: NonNegative = 0.0
    metrics: dict[Count, Mark] = Field(default_factory=dict)
    """Of the two newest checkpoints, by the number of rows that the run had written."""
    config: Label = ""
    """SHA-256 of ``config.yaml`` as it was written last."""


class Companion:
    """What the last checkpoint states of the clock and of files that depend on it.

    It is written before the checkpoint, and keeps what the checkpoint before it states, so that a
    kill between the two leaves both. A run resumes without it, too.
    """

    def __init__(self, directory: Path) -> None:
        self._path, self._stated = directory / NAME, _Stated()
        self._started_at = time.perf_counter()
        self.mark: Callable[[], Mark | None] = lambda: None
        """Returns where ``metrics.csv`` ends now; None of a run without it."""

    @property
    def seconds(self) -> float:
        """Time that the run has taken over all its starts [s]."""
        return self._stated.seconds + time.perf_counter() - self._started_at

    def start(self) -> None:
        """Start counting, on top of the time from ``read``."""
        self._started_at = time.perf_counter()

    def read(self) -> Companion:
        """Read what the file states, nothing if it is missing or damaged; return this object."""
        self._stated = _Stated()
        with contextlib.suppress(OSError, ValueError, RecursionError):
            self._stated = _Stated.model_validate_json(self._path.read_bytes())
        return self

    def marked(self, rows: int) -> Mark | None:
        """Return the mark of the checkpoint at which the run had written so many rows."""
        return self._stated.metrics.get(rows)

    def has_written(self, config: bytes) -> bool:
        """Return whether these are the bytes of ``config.yaml`` as the run wrote it."""
        return self._stated.config == hashlib.sha256(config).hexdigest()

    def write(self, rows: int) -> None:
        """Write the time and the mark of a checkpoint, when the run has written ``rows`` rows."""
        # Marks of this checkpoint and of the one before: a kill leaves one of the two.
        marks = {number: mark for number, mark in self._stated.metrics.items() if number < rows}
        if mark := self.mark():
            marks[rows] = mark
        self._update(metrics=dict(sorted(marks.items())[-2:]))

    def announce(self, config: bytes) -> None:
        """Write that ``config.yaml`` will have these bytes, which a kill may leave before it."""
        self._update(config=hashlib.sha256(config).hexdigest())

    def _update(self, **changes: Any) -> None:
        self._stated = self._stated.model_copy(update=changes)
        now = {"seconds": round(self.seconds, 3)}
        write_json(self._path, self._stated.model_copy(update=now).model_dump())
