"""Summarise a run from its files: validations, number of episodes, and how it ended."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flipperctl import results as lock
from flipperctl.errors import RequestError
from flipperctl.results import METRICS, SUMMARY
from flipperctl.runs.folder import sweep_hint
from flipperctl.training.events import read_rows

_REACHED = ("pitch_variation_100hz", "pitch_variation", "t_cost")
"""Measures of a validation that are means over the episodes that reached the finish."""
_SHOWN = (
    "decision",
    "success_rate",
    "pitch_variation_100hz",
    "pitch_variation",
    "t_cost",
    "return",
    "mean_return",
)


@dataclass(frozen=True)
class RunRows:
    """The rows of a run's ``metrics.csv``."""

    episodes: list[dict[str, str]]
    validations: list[dict[str, str]]

    @classmethod
    def read(cls, run: Path) -> RunRows:
        """Read the rows of a run directory.

        Raises:
            RequestError: it holds no ``metrics.csv``.
        """
        metrics = run / METRICS
        if not metrics.is_file():
            hint = sweep_hint(run) or "is it a run directory?"
            raise RequestError(f"{run} holds no {METRICS}; {hint}")
        rows = read_rows(metrics)
        kinds = ("episode", "validation")
        return cls(*([row for row in rows if row["kind"] == kind] for kind in kinds))


def summarise(run: Path, rows: RunRows) -> dict[str, Any]:
    """Return ``summary.json`` (None if missing), the number of episodes and the validations.

    ``running``: whether a process trains it now.
    """
    file = run / SUMMARY
    return {
        "run": str(run),
        "summary": json.loads(file.read_text("utf-8")) if file.is_file() else None,
        "running": lock.is_held(run),
        "episodes": len(rows.episodes),
        "validations": [
            of_reached({key: _number(row, key) for key in _SHOWN}) for row in rows.validations
        ],
    }


def of_reached(validation: Mapping[str, Any]) -> dict[str, Any]:
    """Return the measures of a validation; None for those of the way to a finish never reached.

    The files have the means over all episodes there, by which validations are ranked.
    """
    if validation.get("success_rate"):
        return dict(validation)
    return {name: None if name in _REACHED else v for name, v in validation.items()}


def _number(row: Mapping[str, str], key: str) -> float | None:
    """Return the number in a cell; None if it is empty, or its column is of a later version."""
    cell = row.get(key)
    return float(cell) if cell else None
