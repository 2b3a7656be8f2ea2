"""One policy on each scene of a suite, beside rules: rows for a file of results, and their table.

In: a folder of ``eval suite=… --output``. Out: a row for each scene and engine, with differences
over the episodes that both reached, and lines of a table in Markdown.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from flipperctl.evaluation.best_known import is_best_known
from flipperctl.evaluation.statistics import Interval, interval
from flipperctl.evaluation.views.markdown import NONE, ends_text

_SWING = "pitch_variation_100hz"
_ROCKED = 5.0
"""θ̂_R above which a failed episode counts as one that rocked [rad]."""


def rows(folder: Path) -> list[dict[str, Any]]:
    """Return the rows of a folder; the first method of the call is the policy.

    ``passable`` counts the episodes that any method reached.
    """
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    played: dict[tuple[str, str], dict[str, dict[str, dict[str, str]]]] = {}
    with (folder / "episodes.csv").open(newline="", encoding="utf-8") as file:
        for line in csv.DictReader(file):
            if is_best_known(line["controller"]):  # the best of the methods once more
                continue
            scene = played.setdefault((line["scene"], line["conditions_hash"]), {})
            scene.setdefault(line["controller"], {})[line["episode"]] = line
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for scene in summary["scenes"]:
        conditions = scene["conditions"]
        key = scene["suite_scene"], conditions["hash"]
        if key not in found:  # each method has an entry
            found[key] = {
                "scene": scene["suite_scene"],
                "terrain": scene["terrain"],
                "engine": conditions["sim"]["name"],
                "hash": conditions["hash"],
                **_compared(played[scene["terrain"], conditions["hash"]]),
            }
    return list(found.values())


def _compared(methods: Mapping[str, Mapping[str, Mapping[str, str]]]) -> dict[str, Any]:
    swings = {
        name: {
            index: float(line[_SWING])
            for index, line in episodes.items()
            if line["outcome"] == "reached"
        }
        for name, episodes in methods.items()
    }
    policy, *others = swings
    ours = swings[policy]
    failed = [line for line in methods[policy].values() if line["outcome"] != "reached"]
    return {
        "episodes": len(methods[policy]),
        "passable": len(set().union(*swings.values())),
        "reached": {name: len(each) for name, each in swings.items()},
        "swing": {name: _ends(list(each.values())) for name, each in swings.items()},
        "difference": {
            other: _ends(
                [swing - swings[other][i] for i, swing in ours.items() if i in swings[other]]
            )
            for other in others
        },
        "rocked": sum(float(line[_SWING]) > _ROCKED for line in failed),
        "overturned": {
            name: sum(line["outcome"] == "overturned" for line in episodes.values())
            for name, episodes in methods.items()
        },
    }


def _ends(values: Sequence[float]) -> list[float | None] | None:
    if not values:
        return None
    found: Interval = interval(values)
    ends = asdict(found)
    return [None if (end := ends[n]) is None else round(end, 6) for n in ("mean", "low", "high")]


def markdown(document: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of the table of a file of results.

    Where its rows know who overturned, one column has the numbers of all, in their order.
    """
    found: list[dict[str, Any]] = document["rows"]
    policy, *others = found[0]["reached"]
    headings = ["scene", "passable", "reached"]
    headings += [f"`{name}` reached" for name in others]
    headings += ["overturned"] if "overturned" in found[0] else []
    headings += ["θ̂_R [rad]", *(f"minus `{name}`'s" for name in others)]
    yield _line(headings)
    yield "|" + "---|" * len(headings)
    several = len({row["terrain"] for row in found if row["scene"] == found[0]["scene"]}) > 1
    for row in found:
        name = f"{row['scene']}, `{row['terrain']}`" if several else row["scene"]
        cells = [name, str(row["passable"]), *(str(row["reached"][m]) for m in (policy, *others))]
        if "overturned" in row:
            cells.append(", ".join(str(row["overturned"][m]) for m in (policy, *others)))
        cells.append(_text(row["swing"][policy], interval=False))
        cells += [_text(row["difference"][name]) for name in others]
        yield _line(cells)


def _text(ends: Sequence[float | None] | None, *, interval: bool = True) -> str:
    if ends is None:
        return NONE
    mean, low, high = ends
    return NONE if mean is None else ends_text((mean, low, high), 2, interval=interval)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
