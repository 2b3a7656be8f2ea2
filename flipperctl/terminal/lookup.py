"""What ``flipperctl list`` and ``flipperctl explain`` print.

In: plain documents. Out: tables and lines on standard output.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from flipperctl.config.words import override_text
from flipperctl.messages import counted
from flipperctl.show import (
    NONE,
    Column,
    Table,
    console,
    print_facts,
    print_lines,
    print_table,
)

Row = Mapping[str, Any]

_KINDS = (
    Column("kind", "kind", named=True),
    Column("count", "count"),
    Column("example", "example", wrapped=True),
)
_NAMES = (Column("name", "name", named=True), Column("summary", "summary", wrapped=True))
_RUNS = (
    Column("name", "run", named=True),
    Column("terrain", "terrain"),
    Column("decisions", "decisions"),
    Column("success", "success"),
    Column("pitch_variation_100hz", "pitch variation [rad]"),
    Column("date", "date"),
)
_FIELDS = (
    Column("default", "default", wrapped=True),
    Column("bounds", "allowed", wrapped=True),
    Column("unit", "unit"),
    Column("description", "meaning", wrapped=True),
)
_SETS = (Column("key", "sets", named=True), Column("value", "to", wrapped=True))
_HITS = (
    Column("name", "name", named=True),
    Column("kind", "kind"),
    Column("summary", "meaning", wrapped=True),
)


def print_kinds(kinds: Sequence[Row]) -> None:
    """Print each kind of names with its count and an example."""
    print_table(Table(_KINDS, [dict(row) for row in kinds]), console())
    print("One kind: flipperctl list KIND")


def print_names(found: Sequence[Row], titles: Mapping[str, str]) -> None:
    """Print a line for each name, in a table for each group; ``titles``: its command."""
    for group, title in titles.items():
        rows = [dict(row) for row in found if row["group"] == group]
        print_table(Table(_NAMES, rows, title), console())
    if found:
        print(f"More about one: flipperctl explain {found[0]['name']}")


def print_runs(folder: Path, found: Sequence[Row]) -> None:
    """Print a line for each run below a folder."""
    rows = []
    for row in found:
        rate, terrain = row["success_rate"], row["terrain"] or NONE
        success = NONE if rate is None else f"{rate:.0%}"
        rows.append({**row, "success": success, "terrain": terrain})
    print_table(Table(_RUNS, rows, f"{folder}: {counted(len(rows), 'run')}"), console())


def print_explained(document: Row) -> None:
    """Print what ``explain`` found: a word's meaning, names, settings, or hits of a search."""
    out = console()
    if document["meaning"]:
        print_lines(out, [f"{document['word']}: {document['meaning']}"])
    for entry in document["names"]:
        _print_entry(entry)
    if len(document["settings"]) == 1:
        _print_setting(document["settings"][0])
    elif settings := document["settings"]:
        columns = Column("key", "setting", named=True), Column("of", "of", named=True)
        rows = [_cells(one) | {"description": one["short"]} for one in settings]
        print_table(Table((*columns, *_FIELDS), rows), out)
        print(f"More about one: flipperctl explain {settings[0]['alias']}")
    if document["found"]:
        title = f"found for {document['word']!r}"
        print_table(Table(_HITS, [dict(hit) for hit in document["found"]], title), out)


def _print_entry(found: Row) -> None:
    """Print a plugin with its settings, or a preset with what it sets."""
    out, plugin = console(), found.get("plugin")
    print_lines(out, [f"{found['name']} ({found['group']}): {found['about'] or found['summary']}"])
    print_facts(
        {"write": found["command"], **({"source": plugin["source"]} if plugin else {})}, out
    )
    if plugin and plugin["fields"]:
        columns = (Column("name", "setting", named=True), *_FIELDS)
        print_table(Table(columns, [_cells(field) for field in plugin["fields"]]), out)
    if found["settings"]:
        rows = [{"key": key, "value": value} for key, value in found["settings"].items()]
        print_table(Table(_SETS, rows), out)


def _print_setting(one: Row) -> None:
    out = console()
    default = override_text(one["default"])
    if one["train"] not in (None, one["default"]):
        default += f"; flipperctl train has {override_text(one['train'])}"
    facts = {
        "default": default,
        "allowed": one["bounds"] or "any",
        "unit": one["unit"] if one["unit"] not in ("-", "") else "none",
        "part of": f"{one['of']} ({one['class']})",
        "set by": ", ".join(f"{name} ({value})" for name, value in one["set_by"].items()),
        "write": one["command"],
    }
    print_lines(out, [f"{one['key']}: {one['description']}"])
    print_facts({name: text for name, text in facts.items() if text}, out)


def _cells(found: Row) -> dict[str, Any]:
    """Return the cells of a row of ``_FIELDS``."""
    unit = "" if found["unit"] == "-" else found["unit"]
    return {**found, "default": override_text(found["default"]), "unit": unit}
