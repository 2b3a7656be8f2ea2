"""The table of ``flipperctl inspect terrain``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from flipperctl.terminal.console import console
from flipperctl.terminal.tables import Table


def print_terrain(name: str, numbers: list[dict[str, Any]], picture: Path | None) -> None:
    """Print a row for each profile (``studies.profiles.sample``), and the picture's name."""
    headings = (
        *("seed", "length [m]", "lowest [m]", "highest [m]", "climb [m]"),
        *("largest face [m]", "steepest slope [°]", "points"),
    )
    drawn = ["drawn"] if any(row["drawn"] for row in numbers) else []
    table = Table([*headings, *drawn], name, right=headings, words=drawn)
    keys = ("length", "lowest", "highest", "climb", "largest_face", "steepest_slope_degrees")
    cells = [
        [
            *(f"{row[key]:.3f}" for key in keys),
            str(len(row["points"])),
            *((_drawn_text(row["drawn"]),) if drawn else ()),
        ]
        for row in numbers
    ]
    seeds = [str(row["seed"]) for row in numbers]
    if len(numbers) > 1 and all(row["points"] == numbers[0]["points"] for row in numbers):
        seeds, cells = ["any"], cells[:1]  # nothing about the terrain is random
    for seed, row in zip(seeds, cells, strict=True):
        table.add(seed, *row)
    table.print(console())
    if any(row["points_drawn"] > len(row["points"]) for row in numbers):
        most = max(row["points_drawn"] for row in numbers)
        print(f"sampled with up to {most} points; those too fine for a track to feel are left out")
    if picture is not None:
        print(f"picture: {picture}")


def _drawn_text(drawn: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in drawn.items())
