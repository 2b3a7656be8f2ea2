"""Tables in Markdown of the results of ``benchmarks.shipped``.

In: the document of a suite. Out: the lines of a table: ``overview``, a row for each method,
``scenes``, a row for each scene and a column for each method, or ``trainings``, the settings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from flipperctl.errors import RequestError
from flipperctl.evaluation.views.markdown import NONE, ends_text
from flipperctl.messages import close_match

_SWING = "pitch_variation_100hz"


def markdown(document: Mapping[str, Any], names: Sequence[str]) -> list[str]:
    """Return the lines of the table that is named.

    Raises:
        RequestError: there is no such table.
    """
    tables = {"trainings": _trainings, "overview": _overview, "scenes": _scenes}
    if len(names) != 1 or names[0] not in tables:
        asked = " ".join(names)
        raise RequestError(
            f"{asked}: there is no such table{close_match(asked, tables)}; known: "
            f"{', '.join(tables)}"
        )
    return tables[names[0]](document)


def _trainings(document: Mapping[str, Any]) -> list[str]:
    cells = [[f"`{row['method']}`", f"`{row['overrides']}`"] for row in document["trainings"]]
    return _lines(["policy", "settings of `flipperctl train`"], cells)


def _overview(document: Mapping[str, Any]) -> list[str]:
    headings = ["policy", "training seeds", "scenes", "episodes of each", "success", "score [rad]"]
    headings += ["θ̂_R where reached [rad]", "score minus `level`'s [rad]"]
    cells = [
        [
            f"`{row['method']}`",
            str(row["seeds"]) if row["seeds"] > 1 else NONE,
            str(row["scenes"]),
            " or ".join(map(str, row["episodes"])),
            ends_text(_ends(row["success"]), 3),
            ends_text(_ends(row["score"]), 2),
            _number(row[_SWING]),
            ends_text(_ends(row["difference"]), 2),
        ]
        for row in document["overview"]
    ]
    return _lines(headings, cells)


def _scenes(document: Mapping[str, Any]) -> list[str]:
    methods = [row["method"] for row in document["overview"]]
    found: dict[tuple[str, str], dict[str, str]] = {}
    for row in document["scenes"]:
        text = f"{row['score'][0]:.2f} ({row['success'][0] * 100:.0f} %)"
        found.setdefault((row["case"], row["terrain"]), {})[row["method"]] = text
    several = len({case for case, _ in found}) > 1
    cells = [
        [
            f"`{terrain}`, {case}" if several else f"`{terrain}`",
            *(by.get(method, NONE) for method in methods),
        ]
        for (case, terrain), by in found.items()
    ]
    return _lines(["scene", *(f"`{method}`" for method in methods)], cells)


def _ends(values: Sequence[float | None] | None) -> tuple[float, float | None, float | None] | None:
    if values is None or values[0] is None:
        return None
    return values[0], values[1], values[2]


def _number(value: float | None) -> str:
    return NONE if value is None else f"{value:.2f}"


def _lines(headings: Sequence[str], cells: Sequence[Sequence[str]]) -> list[str]:
    head, *rest = (f"| {' | '.join(row)} |" for row in [headings, *cells])
    return [head, "|" + "---|" * len(headings), *rest]
