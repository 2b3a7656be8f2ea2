"""The tables of ``flipperctl eval``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich.markup import escape
from rich.table import Table

_ANGLES = ("pitch_variation", "pitch_variation_100hz", "max_pitch", "flipper_travel")
"""Keys of the last columns [rad]."""


def table(document: dict[str, Any]) -> Table:
    """A row a scene, and a dim one a part of a mix."""
    result = Table(title=str(document["controller"]), title_justify="left")
    passable = any("passable" in scene for scene in document["scenes"])
    success = ["success", *(["passable", "of these"] if passable else [])]
    for heading in ("terrain", "episodes", *success, "outcomes", "t_cost [s]"):
        result.add_column(escape(heading))
    for heading in ("θ̂_R [rad]", "θ̂_R 100 Hz [rad]", "largest pitch [rad]", "flipper travel [rad]"):
        result.add_column(escape(heading))
    for name, scene in _named(document):
        result.add_row(*_cells(name, scene))
        for label, part in scene.get("parts", {}).items():
            result.add_row(*_cells(f"  {label}", part), style="dim")
    return result


def _named(document: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Each scene and its terrain; with the hash of its conditions where several are on it."""
    scenes = document["scenes"]
    terrains = [scene["terrain"] for scene in scenes]
    for terrain, scene in zip(terrains, scenes, strict=True):
        alone = terrains.count(terrain) == 1
        yield terrain if alone else f"{terrain} {scene['conditions']['hash']}", scene


def _cells(name: str, summary: dict[str, Any]) -> list[str]:
    fair = summary.get("passable")
    outcomes = " ".join(f"{name} {count}" for name, count in summary["outcomes"].items() if count)
    return [
        name,
        str(summary["episodes"]),
        _shown(summary["success"], 3),
        *([str(fair["episodes"]), _shown(fair["success"], 3)] if fair else []),
        outcomes,
        _shown(summary["t_cost"], 1),
        *(_shown(summary[m]) for m in _ANGLES),
    ]


def comparison(document: dict[str, Any], baseline: str) -> Table:
    """The paired differences to a baseline."""
    title = f"difference to {baseline} on the same draws, where both reached the finish"
    table = Table(title=title, title_justify="left")
    for heading in ("terrain", "pairs", f"{baseline}: success", "Δ t_cost [s]", "Δ θ̂_R [rad]"):
        table.add_column(escape(heading))
    for name, scene in _named(document):
        other = scene["baseline"]
        table.add_row(*_difference_cells(name, other, other["difference"]))
        for label, part in other["difference"].get("parts", {}).items():
            cells = _difference_cells(f"  {label}", other["parts"][label], part)
            table.add_row(*cells, style="dim")
    return table


def _difference_cells(name: str, other: dict[str, Any], difference: dict[str, Any]) -> list[str]:
    return [
        name,
        str((difference["pitch_variation"] or {}).get("episodes", 0)),
        _shown(other["success"], 3),
        _shown(difference["t_cost"], 1),
        _shown(difference["pitch_variation"]),
    ]


def _shown(found: dict[str, float] | None, digits: int = 2) -> str:
    if found is None:
        return "–"
    mean, low, high = (f"{found[key]:.{digits}f}" for key in ("mean", "low", "high"))
    return f"{mean} [{low}, {high}]"
