"""``metrics.csv``, the record that every training run writes.

Its writer is a listener of the trainer; a resumed run continues the file from its checkpoint.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from flipperctl.env.metrics import logged
from flipperctl.errors import CheckpointError, WriteError
from flipperctl.files import failure, write_csv


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
        if not self._path.exists():  # rows would go to a deleted file
            raise WriteError(f"{self._path} was deleted while the run was training")
        try:
            self._writer.writerow(row)
        except OSError as error:
            raise failure(self._path, error) from error

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _complete_rows(path: Path) -> list[dict[str, str]]:
    """Return the complete rows of a ``metrics.csv``; a killed process can leave a partial one."""
    rows = read_rows(path)
    return [row for row in rows if None not in row.values() and row.get("decision", "").isdigit()]


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a ``metrics.csv`` as text by column name.

    Raises:
        CheckpointError: the file is damaged.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))
    except (UnicodeDecodeError, csv.Error) as error:
        raise CheckpointError(
            f"{path} is damaged ({error}); without this file the run goes on, and has no earlier "
            "rows"
        ) from error
