"""What a training run writes while it goes: ``metrics.csv`` and TensorBoard events.

Both listen to the trainer; both can go on at an earlier decision when a run is resumed.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from flipperctl.run.files import failure, write_bytes


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


COLUMNS = (
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
    "t_cost",
    "pitch_variation",
    "pitch_variation_100hz",
    "max_pitch",
    "flipper_travel",
    "start_shift",
    "start_front",
    "start_rear",
    "epsilon",
    "loss",
    "lag",
    "seconds",
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
        self._columns = [*COLUMNS, *draws, *(f"reward_{term}" for term in terms)]
        kept: list[Mapping[str, Any]] = []
        if resume_at is not None and path.is_file():
            with path.open(newline="") as old:
                kept = [row for row in csv.DictReader(old) if int(row["decision"]) <= resume_at]
        text = io.StringIO()
        writer = csv.DictWriter(text, self._columns, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(kept)
        write_bytes(path, text.getvalue().encode())
        self._path = path
        self._file = path.open("a", newline="", buffering=1)
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
        try:
            self._writer.writerow(row)
        except OSError as error:
            raise failure(self._path, error) from error

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class TensorBoard:
    """Scalars under ``episode/`` and ``validation/``, over decisions."""

    def __init__(self, folder: Path, resume_at: int | None = None) -> None:
        from torch.utils.tensorboard import SummaryWriter

        purge = None if resume_at is None else resume_at + 1
        self._writer = SummaryWriter(str(folder), purge_step=purge)

    def episode(self, row: Mapping[str, Any]) -> None:
        """Write the row's numbers."""
        self._write("episode", row)

    def validation(self, row: Mapping[str, Any]) -> None:
        """Write the row's numbers."""
        self._write("validation", row)

    def note(self, text: str) -> None:
        """Write it as text."""
        self._writer.add_text("note", text)

    def _write(self, group: str, row: Mapping[str, Any]) -> None:
        for name, value in row.items():
            if isinstance(value, int | float) and name not in ("decision", "episode", "seed"):
                self._writer.add_scalar(f"{group}/{name}", value, row["decision"])

    def close(self) -> None:
        """Flush and close."""
        self._writer.close()


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a ``metrics.csv``."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))
