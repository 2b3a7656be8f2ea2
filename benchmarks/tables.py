"""Rewrite the tables of the documentation from the results that are kept in ``docs/results/``.

    python -m benchmarks.tables [--check]

A table stands between ``<!-- results: FILE COLUMN … -->`` and ``<!-- end -->``; its columns are
``COLUMNS``, of the policy or, as in ``swing:okada``, of a baseline: with ``method`` a row for each
scene and method, otherwise one for each scene. Files ``shipped_SUITE.json`` have the tables
``overview``, a row for each method, ``scenes``, a row for each scene and a column for each method,
and ``trainings``, the settings, instead; files ``cells_NAME.json`` the table ``cells``; the folder
``benchmark`` those of ``benchmarks/leaderboard.py``. ``--check``
writes nothing and exits with code 1 if a page disagrees with its results. ``python -m
benchmarks.results`` makes the results.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks import leaderboard
from flipperctl.errors import RequestError
from flipperctl.process import entry
from flipperctl.text.files import write_bytes
from flipperctl.text.messages import close_match
from flipperctl.text.show import NONE
from flipperctl.views.card import StoredRow, ends_text

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
    """Return the text of a page with each table made anew from its file in ``folder``."""

    def table(match: re.Match[str]) -> str:
        lines = _lines_of(folder / match[2], match[3].split())
        return match[1] + "\n".join(["", *lines, "", ""]) + match[4]

    return _TABLE.sub(table, text)


def _lines_of(path: Path, names: Sequence[str]) -> list[str]:
    if path.is_dir():
        return leaderboard.lines(path, *names)
    try:
        document: Document = json.loads(path.read_text(encoding="utf-8"))
        if path.name.startswith(SHIPPED):
            return shipped_table(document, names)
        rows: list[StoredRow] = document["rows"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RequestError(f"{path}: these are no stored results: {error}") from error
    return cells_table(rows) if path.name.startswith(CELLS) else markdown_table(rows, names)


def shipped_table(document: Document, names: Sequence[str]) -> list[str]:
    """Return the lines of a table of everything that ships."""
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
        share = f"{row['success'][0] * 100:.0f} %"
        text = f"{row['score'][0]:.2f}" + (f" ({share})" if share != "100 %" else "")
        scenes.setdefault((row["case"], row["terrain"]), {})[row["method"]] = text
    several = len({case for case, _ in scenes}) > 1
    cells = [
        [f"`{terrain}`" + (f", {case}" if several else ""), *(by.get(m, NONE) for m in methods)]
        for (case, terrain), by in scenes.items()
    ]
    return _lines(["scene", *(f"`{method}`" for method in methods)], cells)


def cells_table(rows: Sequence[Document]) -> list[str]:
    """Return the lines of the table of a policy on each scene of a suite, beside rules.

    Where its rows know who overturned, or the flippers' energy, one column has those of all, in
    their order.
    """
    methods = policy, *others = list(rows[0]["reached"])
    overturned = "overturned" in rows[0]
    headings = ["scene", "passable", "reached", *(f"`{name}` reached" for name in others)]
    headings += ["overturned"] if overturned else []
    energy = "energy" in rows[0]
    headings += ["θ̂_R [rad]", *(f"minus `{name}`'s" for name in others)]
    headings += ["flipper energy [J]"] if energy else []
    several = len({row["terrain"] for row in rows if row["scene"] == rows[0]["scene"]}) > 1
    # What all scenes of a suite share, as in "…, sim=planar", its command says.
    endings = {row["scene"].rpartition(", ")[2] for row in rows}
    shared = f", {endings.pop()}" if len(endings) == 1 else ""
    cells = [
        [
            row["scene"].removesuffix(shared) + (f", `{row['terrain']}`" if several else ""),
            str(row["passable"]),
            *(str(row["reached"][name]) for name in methods),
            *([_each(row["overturned"], methods)] if overturned else []),
            _ends(row["swing"][policy], interval=False),
            *(_ends(row["difference"][name]) for name in others),
            *(
                [", ".join(_ends(row["energy"][m], 0, interval=False) for m in methods)]
                if energy
                else []
            ),
        ]
        for row in rows
    ]
    return _lines(headings, cells)


def _each(counts: Mapping[str, int], methods: Sequence[str]) -> str:
    """Return the count of each method, or 0 if that is so of all."""
    return ", ".join(str(counts[method]) for method in methods) if any(counts.values()) else "0"


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


class _Column(NamedTuple):
    heading: str
    text: Callable[[StoredRow], str]


def _columns() -> dict[str, _Column]:
    found = {
        "terrain": _Column("terrain", lambda row: f"`{row['terrain']}`"),
        "conditions": _Column("conditions", lambda row: f"{row['conditions']} {row['hash']}"),
        "engine": _Column("engine", lambda row: row["engine"]),
        "method": _Column("policy", lambda row: f"`{row['method']}`"),
        "n": _Column("episodes", lambda row: str(row["episodes"])),
        "reached": _Column("reached", lambda row: str(row["outcomes"]["reached"])),
        "passable": _Column("passable", lambda row: str(row["passable"]["episodes"])),
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
        ("decisions", "pitch_variation_decisions", "θ̂_R at decisions [rad]", 2),
        ("time", "t_cost", "time [s]", 1),
        ("pitch", "max_pitch", "largest pitch [rad]", 2),
        ("travel", "flipper_travel", "flipper travel [rad]", 1),
        ("energy", "flipper_energy", "flipper energy [J]", 0),
    ):
        for sign, interval in (("", False), ("+", True)):

            def text(
                row: StoredRow,
                measure: str = measure,
                digits: int = digits,
                interval: bool = interval,
            ) -> str:
                return ends_text(row["measures"][measure], digits, interval=interval)

            found[name + sign] = _Column(heading, text)
    return found


COLUMNS = _columns()
"""Columns by name; ``+`` adds the intervals of a measure."""


def markdown_table(rows: Sequence[StoredRow], names: Sequence[str]) -> list[str]:
    """Return the lines of a table with the named columns."""
    columns, headings = [], []
    for name in names:
        quantity, _, method = name.partition(":")
        if quantity not in COLUMNS:
            hint, known = close_match(quantity, COLUMNS), ", ".join(COLUMNS)
            raise RequestError(f"{name}: there is no such column{hint}; known: {known}")
        heading, text = COLUMNS[quantity]
        columns.append((text, method))
        of_method = f"`{method}`: {heading}"
        if quantity == "difference":
            of_method = f"θ̂_R minus `{method}`'s"
        headings.append(of_method if method else heading)
    if "method" in names:
        return _lines(headings, [[text(row) for text, _ in columns] for row in rows])
    scenes: list[list[StoredRow]] = []  # the rows of each, the policy's first
    for row in rows:
        if row["is_policy"]:
            scenes.append([])
        scenes[-1].append(row)
    return _lines(
        headings, [[text(_method(scene, method)) for text, method in columns] for scene in scenes]
    )


def _method(scene: Sequence[StoredRow], method: str) -> StoredRow:
    """Return the row of a method, or of the policy if it has no name."""
    for row in scene:
        if row["method"] == method if method else row["is_policy"]:
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
