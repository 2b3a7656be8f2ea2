"""What a training run writes while it goes: ``metrics.csv`` and TensorBoard events.

Both listen to the trainer; both can go on at an earlier decision when a run is resumed.
"""

from __future__ import annotations

import csv
import io
import os
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, cast

from flipperctl.env import measures
from flipperctl.errors import WriteError
from flipperctl.files import failure, make_folder, write_bytes


class Listener(Protocol):
    """Hears of every episode that ends, of every validation, and of what the user should know."""

    def episode(self, row: Mapping[str, Any]) -> None:
        """A training episode ended."""

    def validation(self, row: Mapping[str, Any]) -> None:
        """A validation is done."""

    def note(self, text: str) -> None:
        """Something happened that the user should know."""

    def close(self) -> None:
        """The run ended, in whatever way."""


def columns() -> tuple[str, ...]:
    """Return the columns that every ``metrics.csv`` has."""
    named = [measure.name for measure in measures.MEASURES if measure.name != "decisions"]
    return (
        *("kind", "decision", "episode", "seed", "terrain", "difficulty", "outcome"),
        *("success_rate", "decisions", "return", *named),
        *("start_shift", "start_front", "start_rear", "epsilon", "loss", "lag", "seconds"),
    )


class MetricsCsv:
    """One row an episode and one a validation (``kind`` tells them apart)."""

    def __init__(
        self,
        path: Path,
        terms: Sequence[str],
        draws: Sequence[str] = (),
        resume_at: int | None = None,
    ) -> None:
        """``draws``: settings that are randomised.

        ``resume_at``: rows behind this decision are dropped; None begins a new file.
        """
        self._columns = [*columns(), *draws, *(f"reward_{term}" for term in terms)]
        kept: list[Mapping[str, Any]] = []
        if resume_at is not None and path.is_file():
            kept = [row for row in _whole_rows(path) if int(row["decision"]) <= resume_at]
        text = io.StringIO()
        writer = csv.DictWriter(text, self._columns, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(kept)
        write_bytes(path, text.getvalue().encode())
        self._path = path
        self._file = path.open("a", encoding="utf-8", newline="", buffering=1)
        self._writer = csv.DictWriter(self._file, self._columns, extrasaction="ignore")

    def episode(self, row: Mapping[str, Any]) -> None:
        """Append a row."""
        self._write({"kind": "episode", **row})

    def validation(self, row: Mapping[str, Any]) -> None:
        """Append a row of means."""
        self._write({"kind": "validation", **row})

    def note(self, text: str) -> None:
        """Not a row's business."""

    def _write(self, row: Mapping[str, Any]) -> None:
        if not self._path.exists():  # rows would go into a file that nobody can find
            raise WriteError(f"{self._path} was deleted while the run was training")
        try:
            self._writer.writerow(row)
        except OSError as error:
            raise failure(self._path, error) from error

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class TensorBoard:
    """Scalars under ``episode/`` and ``validation/``, over decisions.

    The events are those of torch's SummaryWriter, but written here and not in a thread of their
    own, which would print a traceback when the disk is full or the folder is deleted.
    """

    def __init__(self, folder: Path, resume_at: int | None = None) -> None:
        from tensorboard.summary.writer.record_writer import RecordWriter

        make_folder(folder)
        host, process = socket.gethostname(), os.getpid()
        name = f"events.out.tfevents.{int(time.time()):010d}.{host}.{process}.{time.time_ns()}"
        self._path = folder / name
        self._file = self._path.open("wb")
        self._writer: Any = RecordWriter(self._file)
        self._event(file_version="brain.Event:2")
        if resume_at is not None:
            self._drop_after(resume_at)

    def episode(self, row: Mapping[str, Any]) -> None:
        """Write the row's numbers."""
        self._scalars("episode", row)

    def validation(self, row: Mapping[str, Any]) -> None:
        """Write the row's numbers."""
        self._scalars("validation", row)
        self._attempt(self._file.flush)

    def note(self, text: str) -> None:
        """Write it as text."""
        from torch.utils.tensorboard import summary

        self._event(summary=cast("Any", summary).text("note", text))

    def _scalars(self, group: str, row: Mapping[str, Any]) -> None:
        from torch.utils.tensorboard import summary

        scalar = cast("Any", summary).scalar
        for name, value in row.items():
            if isinstance(value, int | float) and name not in ("decision", "episode", "seed"):
                self._event(summary=scalar(f"{group}/{name}", value), step=row["decision"])

    def _drop_after(self, decision: int) -> None:
        """Let viewers forget what an earlier start of the run wrote after this decision."""
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
        """Flush and close."""
        self._attempt(self._file.close)


def _whole_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a ``metrics.csv``, but not one that was cut off when its process died."""
    rows = read_rows(path)
    return [row for row in rows if None not in row.values() and row.get("decision", "").isdigit()]


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a ``metrics.csv``."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))
