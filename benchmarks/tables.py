"""Rewrite the tables of the documentation from the results that are kept in ``docs/results/``.

    python -m benchmarks.tables [--check]

A table stands between ``<!-- results: FILE COLUMN … -->`` and ``<!-- end -->``; its columns are
those of ``flipperctl.evaluation.views.markdown``; files ``shipped_SUITE.json`` have the tables
``overview`` and ``scenes`` instead (``benchmarks.shipped_table``), and files ``cells_NAME.json``
the table ``cells`` (``benchmarks.cells``). ``--check`` writes nothing and
exits with code 1 if a page disagrees with its results. ``python -m benchmarks.results`` makes the
results.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks import cells
from benchmarks.shipped_table import markdown
from flipperctl import entry
from flipperctl.errors import RequestError
from flipperctl.evaluation.views.markdown import StoredRow, markdown_table
from flipperctl.files import write_bytes

ROOT = Path(__file__).parents[1]
SHIPPED = "shipped_"
"""Beginning of the names of files of ``benchmarks.shipped``; their tables are others."""
CELLS = "cells_"
"""Beginning of the names of files of ``benchmarks.cells``."""
FOLDER = ROOT / "docs" / "results"
_TABLE = re.compile(
    r"(<!-- results: (\S+) ([^>]*?) -->\n).*?(^<!-- end -->$)", re.DOTALL | re.MULTILINE
)


def pages() -> list[Path]:
    """Return the pages that may hold tables of results."""
    return [
        ROOT / "README.md",
        *sorted((ROOT / "docs").glob("**/*.md")),
        *sorted((ROOT / "flipperctl" / "policies").glob("*.md")),
    ]


def rewritten(text: str, folder: Path = FOLDER) -> str:
    """Return the text of a page with each table made anew from its file in ``folder``.

    Raises:
        RequestError: a file is missing or no stored results, or a column does not exist.
    """

    def table(found: re.Match[str]) -> str:
        path, names = folder / found[2], found[3].split()
        if found[2].startswith(SHIPPED):
            lines = markdown(_document(path), names)
        elif found[2].startswith(CELLS):
            lines = list(cells.markdown(_document(path)))
        else:
            lines = markdown_table(stored(path), names)
        return found[1] + "\n".join(["", *lines, "", ""]) + found[4]

    return _TABLE.sub(table, text)


def stored(path: Path) -> list[StoredRow]:
    """Return the rows of a file that ``benchmarks.results`` wrote.

    Raises:
        RequestError: it is missing, or of another form.
    """
    try:
        return list(_document(path)["rows"])
    except (KeyError, TypeError) as error:
        raise RequestError(f"{path}: these are no stored results: {error}") from error


def _document(path: Path) -> dict[str, Any]:
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return found
    except (OSError, ValueError) as error:
        raise RequestError(f"{path}: these are no stored results: {error}") from error


def changes() -> Iterator[tuple[Path, str]]:
    """Yield each page that disagrees with its results, and its text as it should be."""
    for page in pages():
        text = page.read_text(encoding="utf-8")
        if (new := rewritten(text)) != text:
            yield page, new


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
