"""Rewrite the tables of the documentation from the results that are kept in ``docs/results/``.

    python -m benchmarks.tables [--check]

A table stands between ``<!-- results: FILE COLUMN … -->`` and ``<!-- end -->``; its columns are
``COLUMNS``, of the policy or, as in ``swing:okada``, of a baseline: with ``method`` a row for each
scene and method, otherwise one for each scene. Files ``shipped_SUITE.json`` have the tables
``overview``, a row for each method, ``scenes``, a row for each scene and a column for each method,
and ``trainings``, the settings, instead; files ``cells_NAME.json`` the table ``cells``. ``--check``
writes nothing and exits with code 1 if a page disagrees with its results. ``python -m
benchmarks.results`` makes the results.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flipperctl import entry
from flipperctl.errors import RequestError
from flipperctl.evaluation.views.card import StoredRow, ends_text
from flipperctl.files import write_bytes
from flipperctl.messages import close_match
from flipperctl.show import NONE

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "results"
"""Folder of the kept results."""
SHIPPED, CELLS = "shipped_", "cells_"
"""Beginnings of the names of files that have tables of their own."""
_SWING = "pitch_variation_100hz"
_TABLE = re.compile(
    r"(<!-- results: (\S+) ([^>]*?) -->\n).*?(^<!-- end -->$)", re.DOTALL | re.MULTILINE
)
Document = Mapping[str, Any]
Ends = Sequence[float | None] | None
"""A mean with the ends of its interval."""


def pages() -> list[Path]:
    """Return the pages that may hold tables of results."""
    folders = ROOT / "docs", ROOT / "flipperctl" / "policies"
    return [ROOT / "README.md", *(page for one in folders for page in sorted(one.glob("**/*.md")))]


def rewritten(text: str, folder: Path = FOLDER) -> str:
    """Return the text of a page with each table made anew from its file in ``folder``.

    Raises:
        RequestError: a file is missing or no stored results, or a table or column does not exist.
    """

    def table(match: re.Match[str]) -> str:
        lines = _lines_of(folder / match[2], match[3].split())
        return match[1] + "\n".join(["", *lines, "", ""]) + match[4]

    return _TABLE.sub(table, text)


def _lines_of(path: Path, names: Sequence[str]) -> list[str]:
    try:
        document: Document = json.loads(path.read_text(encoding="utf-8"))
        if path.name.startswith(SHIPPED):
            return shipped_table(document, names)
        rows: list[StoredRow] = document["rows"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RequestError(f"{path}: these are no stored results: {error}") from error
    return cells_table(rows) if path.name.startswith(CELLS) else markdown_table(rows, names)


def shipped_table(document: Document, names: Sequence[str]) -> list[str]:
    """Return the lines of a table of ``benchmarks.shipped``.

    Raises:
        RequestError: there is no such table.
    """
    tables: Mapping[str, Callable[[Document], list[str]]]
    tables = {"trainings": _trainings, "overview": _overview, "scenes": _scenes}
    asked = " ".join(names)
    if asked not in tables:
        hint = close_match(asked, tables)
        raise RequestError(f"{asked}: there is no such table{hint}; known: {', '.join(tables)}")
    return tables[asked](document)


def _trainings(document: Document) -> list[str]:
    cells = [[f"`{row['method']}`", f"`{row['overrides']}`"] for row in document["trainings"]]
    return _lines(["policy", "settings of `flipperctl train`"], cells)


def _overview(document: Document) -> list[str]:
    headings = ["policy", "training seeds", "scenes", "episodes of each", "success", "score [rad]"]
    headings += ["θ̂_R where reached [rad]", "score minus `level`'s [rad]"]
    cells = [
        [
            f"`{row['method']}`",
            str(row["seeds"]) if row["seeds"] > 1 else NONE,
            str(row["scenes"]),
            " or ".join(map(str, row["episodes"])),
            _ends(row["success"], 3),
            _ends(row["score"]),
            NONE if row[_SWING] is None else f"{row[_SWING]:.2f}",
            _ends(row["difference"]),
        ]
        for row in document["overview"]
    ]
    return _lines(headings, cells)


def _scenes(document: Document) -> list[str]:
    methods = [row["method"] for row in document["overview"]]
    scenes: dict[tuple[str, str], dict[str, str]] = {}
    for row in document["scenes"]:
        text = f"{row['score'][0]:.2f} ({row['success'][0] * 100:.0f} %)"
        scenes.setdefault((row["case"], row["terrain"]), {})[row["method"]] = text
    several = len({case for case, _ in scenes}) > 1
    cells = [
        [f"`{terrain}`" + (f", {case}" if several else ""), *(by.get(m, NONE) for m in methods)]
        for (case, terrain), by in scenes.items()
    ]
    return _lines(["scene", *(f"`{method}`" for method in methods)], cells)


def cells_table(rows: Sequence[Document]) -> list[str]:
    """Return the lines of the table of a policy on each scene of a suite, beside rules.

    Where its rows know who overturned, one column has the numbers of all, in their order.
    """
    methods = policy, *others = list(rows[0]["reached"])
    overturned = "overturned" in rows[0]
    headings = ["scene", "passable", "reached", *(f"`{name}` reached" for name in others)]
    headings += ["overturned"] if overturned else []
    headings += ["θ̂_R [rad]", *(f"minus `{name}`'s" for name in others)]
    several = len({row["terrain"] for row in rows if row["scene"] == rows[0]["scene"]}) > 1
    cells = [
        [
            f"{row['scene']}, `{row['terrain']}`" if several else row["scene"],
            str(row["passable"]),
            *(str(row["reached"][name]) for name in methods),
            *([", ".join(str(row["overturned"][m]) for m in methods)] if overturned else []),
            _ends(row["swing"][policy], interval=False),
            *(_ends(row["difference"][name]) for name in others),
        ]
        for row in rows
    ]
    return _lines(headings, cells)


def _ends(ends: Ends, digits: int = 2, *, interval: bool = True) -> str:
    if ends is None or ends[0] is None:
        return NONE
    return ends_text((ends[0], ends[1], ends[2]), digits, interval=interval)


def _lines(headings: Sequence[str], cells: Sequence[Sequence[str]]) -> list[str]:
    head, *rest = (f"| {' | '.join(row)} |" for row in [headings, *cells])
    return [head, "|" + "---|" * len(headings), *rest]


def changes() -> Iterator[tuple[Path, str]]:
    """Yield each page that disagrees with its results, and its text as it should be."""
    for page in pages():
        text = page.read_text(encoding="utf-8")
        if (new := rewritten(text)) != text:
            yield page, new


@dataclass(frozen=True)
class _Column:
    heading: str
    text: Callable[[StoredRow], str]


def _measured(name: str, heading: str, digits: int) -> dict[str, _Column]:
    """Return the column of a measure, and with a ``+`` the one with intervals."""

    def column(interval: bool) -> _Column:
        return _Column(
            heading, lambda row: ends_text(row["measures"][name], digits, interval=interval)
        )

    return {"": column(False), "+": column(True)}


def _columns() -> dict[str, _Column]:
    found = {
        "terrain": _Column("terrain", lambda row: f"`{row['terrain']}`"),
        "conditions": _Column("conditions", lambda row: f"{row['conditions']} {row['hash']}"),
        "engine": _Column("engine", lambda row: row["engine"]),
        "method": _Column("policy", lambda row: f"`{row['method']}`"),
        "n": _Column("episodes", lambda row: str(row["episodes"])),
        "reached": _Column("reached", lambda row: str(row["outcomes"]["reached"])),
        "stuck": _Column("stuck", lambda row: str(row["outcomes"]["stuck"])),
        "overturned": _Column("overturned", lambda row: str(row["outcomes"]["overturned"])),
        "timeout": _Column("timeout", lambda row: str(row["outcomes"]["timeout"])),
        "success": _Column("success", lambda row: ends_text(row["success"], 3)),
        "difference": _Column(
            "policy's θ̂_R minus this [rad]", lambda row: ends_text(row["difference"], 2)
        ),
    }
    for name, measure, heading, digits in (
        ("swing", "pitch_variation_100hz", "θ̂_R [rad]", 2),
        ("decisions", "pitch_variation", "θ̂_R at decisions [rad]", 2),
        ("time", "t_cost", "t_cost [s]", 1),
        ("pitch", "max_pitch", "largest pitch [rad]", 2),
        ("travel", "flipper_travel", "flipper travel [rad]", 1),
    ):
        found |= {f"{name}{s}": c for s, c in _measured(measure, heading, digits).items()}
    return found


COLUMNS = _columns()
"""Columns by name; ``+`` adds the intervals of a measure."""


def markdown_table(rows: Sequence[StoredRow], names: Sequence[str]) -> list[str]:
    """Return the lines of a table with the named columns."""
    columns = [_find(name) for name in names]
    if "method" in names:
        cells = [[column.text(row) for column, _ in columns] for row in rows]
    else:
        cells = [
            [column.text(_method(scene, method)) for column, method in columns]
            for scene in _by_scene(rows)
        ]
    headings = [_heading(column, method) for column, method in columns]
    return _lines(headings, cells)


def _find(name: str) -> tuple[_Column, str | None]:
    """Return a column and the method that it shows; None for the policy."""
    quantity, _, method = name.partition(":")
    if quantity not in COLUMNS:
        raise RequestError(
            f"{name}: there is no such column{close_match(quantity, COLUMNS)}; known: "
            f"{', '.join(COLUMNS)}"
        )
    return COLUMNS[quantity], method or None


def _heading(column: _Column, method: str | None) -> str:
    if method is None:
        return column.heading
    if column is COLUMNS["difference"]:
        return f"θ̂_R minus `{method}`'s"
    return f"`{method}`: {column.heading}"


def _by_scene(rows: Sequence[StoredRow]) -> list[list[StoredRow]]:
    """Return the rows of each scene, the policy's first."""
    scenes: list[list[StoredRow]] = []
    for row in rows:
        if row["is_policy"]:
            scenes.append([])
        scenes[-1].append(row)
    return scenes


def _method(scene: Sequence[StoredRow], method: str | None) -> StoredRow:
    for row in scene:
        if row["is_policy"] if method is None else row["method"] == method:
            return row
    known = ", ".join(row["method"] for row in scene)
    raise RequestError(f"{scene[0]['terrain']}: there is no result of {method!r}; known: {known}")


def main() -> int:
    """Rewrite the pages, or check them; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tables", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if stale")
    check = parser.parse_args().check
    found = list(changes())
    for page, text in found:
        print(f"{'stale' if check else 'wrote'} {page.relative_to(ROOT)}")
        if not check:
            write_bytes(page, text.encode())
    return int(check and bool(found))


if __name__ == "__main__":
    entry.run(main)
