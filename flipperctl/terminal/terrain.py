"""The table of ``flipperctl inspect terrain``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flipperctl.show import Column, Table, print_table
from flipperctl.terminal.console import console

_COLUMNS = (
    Column("seed", "seed", named=True),
    Column("length", "length [m]", 3),
    Column("lowest", "lowest [m]", 3),
    Column("highest", "highest [m]", 3),
    Column("climb", "climb [m]", 3),
    Column("largest_face", "largest face [m]", 3),
    Column("steepest_slope_degrees", "steepest slope [°]", 3),
    Column("points", "points"),
    Column("drawn", "drawn", wrapped=True),
)


def print_terrain(name: str, numbers: list[dict[str, Any]], picture: Path | None) -> None:
    """Print a row for each profile (``studies.profiles.sample``), and the picture's name."""
    rows = [
        row | {"points": len(row["points"]), "drawn": _drawn_text(row["drawn"])} for row in numbers
    ]
    if len(numbers) > 1 and all(row["points"] == numbers[0]["points"] for row in numbers):
        rows = [rows[0] | {"seed": "any"}]  # nothing about the terrain is random
    columns = _COLUMNS if any(row["drawn"] for row in rows) else _COLUMNS[:-1]
    print_table(Table(columns, rows, name), console())
    if any(row["points_drawn"] > len(row["points"]) for row in numbers):
        most = max(row["points_drawn"] for row in numbers)
        print(f"sampled with up to {most} points; those too fine for a track to feel are left out")
    if picture is not None:
        print(f"picture: {picture}")


def _drawn_text(drawn: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in drawn.items())
