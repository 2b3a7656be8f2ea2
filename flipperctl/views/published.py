"""Our results beside those that papers published of the same scenes.

In: the document of an evaluation. Out: a table, or None where no experiment was repeated.
"""

from __future__ import annotations

from flipperctl.api import Terrain, registry
from flipperctl.config import to_dict
from flipperctl.evaluation.rows import Row
from flipperctl.text.messages import percent
from flipperctl.text.show import Column, Table
from flipperctl.views.summary import Document, compared, shown_names

_COLUMNS = (
    Column("terrain", "scene", named=True),
    Column("policy", "of", named=True),
    Column("success", "success"),
    Column("time", "time [s]"),
    Column("variation", "pitch variation at decisions [rad]"),
    Column("range", "its range [rad]"),
)


def published(evaluated: Document, *, strict: bool = True) -> Table | None:
    """Return our results above published ones; None if no scene repeats their experiment.

    ``strict``: only under their conditions; else a note tells which these are.
    """
    scenes: dict[type[Terrain], list[Row]] = {}
    others: dict[str, None] = {}
    called = shown_names(evaluated)
    # Our rows on scenes that repeat an experiment
    for scene in evaluated["scenes"]:
        terrain, conditions = registry.get(("terrain", scene["terrain"])), scene["conditions"]
        if terrain is None or not (issubclass(terrain, Terrain) and terrain.published):
            continue
        repeated = terrain.published[0].conditions == conditions["name"]
        defaults = {"name": scene["terrain"], **to_dict(terrain())}
        if conditions["terrain"] != defaults or not (repeated or not strict):
            continue
        if not repeated:
            others[conditions["name"]] = None
        rows = scenes.setdefault(terrain, [])
        for summary in (scene, *([] if "method" in scene else compared(scene))):
            variation = summary["pitch_variation_decisions"] or {}
            rows.append(
                {
                    "policy": called[scene.get("method") or summary["controller"]],
                    "success": percent(summary["success"]["mean"]),
                    "time": (summary["t_cost"] or {}).get("mean"),
                    "variation": variation.get("mean"),
                    "range": variation.get("range"),
                }
            )
    table = Table(_COLUMNS, [], "Beside published results, where reached")
    # The published rows below ours
    for terrain, rows in scenes.items():
        papers = [
            {
                "policy": published_row.source,
                "success": "",
                "time": published_row.t_cost,
                "variation": published_row.pitch_variation,
                "range": published_row.pitch_variation_range,
            }
            for published_row in terrain.published
        ]
        table_rows = [{"terrain": "", "line": False, **row} for row in (*rows, *papers)]
        table.rows += [
            table_rows[0] | {"terrain": terrain.plugin_name, "line": True},
            *table_rows[1:],
        ]
    if others:
        word = next(iter(scenes)).published[0].conditions
        table.notes.append(
            f"Played with conditions={','.join(others)}; conditions={word} repeats the experiment."
        )
    return table if table.rows else None
