"""An evaluation's results beside published ones.

In: a document of ``eval``. Out: a table of the scenes that repeat a published experiment.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from flipperctl.api import Published, Terrain
from flipperctl.config import resolver, to_dict
from flipperctl.evaluation.views.summary import Document, rate_text, short
from flipperctl.show import Column, Table

_COLUMNS = (
    Column("terrain", "scene", named=True),
    Column("policy", "of", named=True),
    Column("success", "success"),
    Column("time", "time [s]"),
    Column("variation", "pitch variation at decisions [rad]"),
    Column("range", "its range [rad]"),
)


def table(document: Document) -> Table | None:
    """Return a row for each such scene and one for what was published; None without such scenes."""
    rows: list[dict[str, Any]] = []
    for scene in document["scenes"]:
        for known in _published(scene):
            time, variation = scene["t_cost"], scene["pitch_variation"]
            rows.append(
                {
                    "terrain": scene["terrain"],
                    "policy": short(scene.get("method") or scene["controller"]),
                    "success": rate_text(scene["success"]),
                    "time": None if time is None else time["mean"],
                    "variation": None if variation is None else variation["mean"],
                    "range": None if variation is None else variation["range"],
                }
            )
            rows.append(
                {
                    "terrain": "",
                    "policy": known.source,
                    "success": "",
                    "time": known.t_cost,
                    "variation": known.pitch_variation,
                    "range": known.pitch_variation_range,
                }
            )
    return Table(_COLUMNS, rows, "Beside published results, where reached") if rows else None


def _published(scene: Mapping[str, Any]) -> Iterator[Published]:
    """Yield the results that were published for a scene's terrain under its conditions."""
    terrain = resolver.get("terrain", scene["terrain"], "terrain")
    assert issubclass(terrain, Terrain)
    known, conditions = terrain.published, scene["conditions"]
    if known is None or known.conditions != conditions["name"]:
        return
    if conditions["terrain"] == {"name": scene["terrain"], **to_dict(terrain())}:
        yield known
