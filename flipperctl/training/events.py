"""The records of a training run: ``metrics.csv`` and TensorBoard events.

Both are listeners of the trainer; both can continue from an earlier decision when a run is resumed.
"""

from __future__ import annotations

import csv
import os
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, cast

from flipperctl.env.metrics import measures
from flipperctl.errors import WriteError
from flipperctl.files import failure, make_folder, write_csv


class Listener(Protocol):
    """Receives every episode that ends, every validation and every note for the user."""

    def episode(self, row: Mapping[str, Any]) -> None:
        """Record a training episode that ended."""

    def validation(self, row: Mapping[str, Any]) -> None:
        """Record a validation."""

    def note(self, text: str) -> None:
        """Record an event that the user should know, as a sentence."""

    def close(self) -> None:
        """Release resources; called once, also when the run failed."""


def columns() -> tuple[str, ...]:
    """Return the columns that every ``metrics.csv`` has."""
    named = [name for name in measures() if name != "decisions"]
    return (
        *("kind", "decision", "episode", "seed", "terrain", "difficulty", "outcome"),
        *("success_rate", "decisions", "return", *named),
        *("start_shift", "start_front", "start_rear", "epsilon", "loss", "lag", "seconds"),
    )


class MetricsCsv:
    """Writes a row for each episode and for each validation; ``kind`` distinguishes them."""

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
            kept = [row for row in _complete_rows(path) if int(row["decision"]) <= resume_at]
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
        if not self._path.exists():  # rows would be written to a file without a name
            raise WriteError(f"{self._path} was deleted while the run was training")
        try:
            self._writer.writerow(row)
        except OSError as error:
            raise failure(self._path, error) from error

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class TensorBoard:
    """Writes scalars under ``episode/`` and ``validation/``, with decisions as steps.

    The events are those of torch's SummaryWriter, but they are written in this thread: the thread
    of SummaryWriter would print a traceback when the disk is full or the folder is deleted.
    """

    def __init__(self, folder: Path, resume_at: int | None = None) -> None:
        """``resume_at``: decision after which earlier events are dropped; None for a new run."""
        from tensorboard.summary.writer.record_writer import RecordWriter

        make_folder(folder)
        host, process = socket.gethostname(), os.getpid()
        name = f"events.out.tfevents.{int(time.time()):010d}.{host}.{process}.{time.time_ns()}"
        self._path = folder / name
        self._file = self._path.open("wb")
        self._writer: Any = RecordWriter(self._file)
        try:
            self._event(file_version="brain.Event:2")
            if resume_at is not None:
                self._drop_after(resume_at)
        except BaseException:
            self._file.close()
            raise

    def episode(self, row: Mapping[str, Any]) -> None:
        """Write the row's numbers."""
        self._scalars("episode", row)

    def validation(self, row: Mapping[str, Any]) -> None:
        """Write the row's numbers."""
        self._scalars("validation", row)
        self._attempt(self._file.flush)

    def note(self, text: str) -> None:
        """Write the note as text."""
        from torch.utils.tensorboard import summary

        self._event(summary=cast("Any", summary).text("note", text))

    def _scalars(self, group: str, row: Mapping[str, Any]) -> None:
        from torch.utils.tensorboard import summary

        scalar = cast("Any", summary).scalar
        for name, value in row.items():
            if isinstance(value, int | float) and name not in ("decision", "episode", "seed"):
                self._event(summary=scalar(f"{group}/{name}", value), step=row["decision"])

    def _drop_after(self, decision: int) -> None:
        """Make viewers drop the events after this decision from an earlier start of the run."""
        from tensorboard.compat.proto.event_pb2 import SessionLog

        self._event(session_log=SessionLog(status=SessionLog.START), step=decision + 1)

    def _event(self, **fields: Any) -> None:
        from tensorboard.compat.proto.event_pb2 import Event

        event = Event(wall_time=time.time(), **fields).SerializeToString()
        self._attempt(lambda: self._writer.write(event))

    def _attempt(self, write: Callable[[], object]) -> None:
        try:
            write()
        except OSError as error:
            raise failure(self._path, error) from error

    def close(self) -> None:
        """Flush and close the file."""
        self._attempt(self._file.close)


def _complete_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a ``metrics.csv``, without one that was cut off when its process died."""
    rows = read_rows(path)
    return [row for row in rows if None not in row.values() and row.get("decision", "").isdigit()]


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a ``metrics.csv``, column name to text."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))
