"""``logger=tensorboard``, the default: event files in the run directory."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from flipperctl.api import Listener, Logger, RunInfo, logger, scalars

_FIRST = ("success_rate", "return", "pitch_variation_100hz")
"""Columns of validations that stand a second time, in the group that a viewer opens first."""


@logger("tensorboard")
class TensorBoard(Logger):
    """Write TensorBoard events to ``tensorboard/`` in the run directory."""

    def open(self, run: RunInfo) -> Listener:
        """Open a new event file."""
        return Events(run.folder, run.resume_at)


class Events:
    """Write scalars under ``at_a_glance/``, ``episode/`` and ``validation/``; steps are decisions.

    They are written in this thread: that of torch's SummaryWriter would print a traceback when the
    disk is full or the folder is deleted.
    """

    def __init__(self, folder: Path, resume_at: int | None = None) -> None:
        """``resume_at``: decision after which earlier events are dropped; None for a new run."""
        from tensorboard.summary.writer.record_writer import RecordWriter

        folder.mkdir(parents=True, exist_ok=True)
        host, process = socket.gethostname(), os.getpid()
        # Viewers recognise event files by this form of their names.
        name = f"events.out.tfevents.{int(time.time()):010d}.{host}.{process}.{time.time_ns()}"
        self._file = (folder / name).open("wb")
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
        # Viewers open the first groups by name.
        self._scalars("at_a_glance", {name: row.get(name) for name in ("decision", *_FIRST)})
        self._file.flush()

    def note(self, text: str) -> None:
        """Write the note as text."""
        from torch.utils.tensorboard import summary

        self._event(summary=cast("Any", summary).text("note", text))

    def _scalars(self, group: str, row: Mapping[str, Any]) -> None:
        from tensorboard.compat.proto.summary_pb2 import Summary

        # A single event for the whole row takes a third of the time and of the space.
        numbers = scalars(group, row).items()
        values = [Summary.Value(tag=name, simple_value=number) for name, number in numbers]
        self._event(summary=Summary(value=values), step=row["decision"])

    def _drop_after(self, decision: int) -> None:
        """Make viewers drop the events after this decision from an earlier start of the run."""
        from tensorboard.compat.proto.event_pb2 import SessionLog

        self._event(session_log=SessionLog(status=SessionLog.START), step=decision + 1)

    def _event(self, **fields: Any) -> None:
        from tensorboard.compat.proto.event_pb2 import Event

        self._writer.write(Event(wall_time=time.time(), **fields).SerializeToString())

    def close(self) -> None:
        """Flush and close the file."""
        self._file.close()
