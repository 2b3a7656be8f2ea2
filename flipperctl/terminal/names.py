"""What ``list`` and ``explain`` print: kinds, names, runs, settings, and what a search found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from flipperctl.config.words import override_text
from flipperctl.text.messages import counted, percent
from flipperctl.text.show import (
    NONE,
    Column,
    Table,
    console,
    print_facts,
    print_lines,
    print_table,
)

Row = Mapping[str, Any]

_KIND_COLUMNS = (
    Column("kind", "kind", named=True),
    Column("count", "count"),
    Column("example", "example", wrapped=True),
)
_NAME_COLUMNS = (Column("name", "name", named=True), Column("summary", "summary", wrapped=True))
_RUN_COLUMNS = (
    Column("name", "run", named=True),
    Column("terrain", "terrain"),
    Column("decisions", "decisions"),
    Column("success", "success"),
    Column("pitch_variation_100hz", "pitch variation [rad]"),
    Column("date", "date"),
)
_FIELD_COLUMNS = (
    Column("default", "default", wrapped=True),
    Column("bounds", "allowed", wrapped=True),
    Column("unit", "unit"),
    Column("description", "meaning", wrapped=True),
)
_PRESET_COLUMNS = (Column("key", "sets", named=True), Column("value", "to", wrapped=True))
_HIT_COLUMNS = (
    Column("name", "name", named=True),
    Column("kind", "kind"),
    Column("summary", "meaning", wrapped=True),
)


def print_kinds(kinds: Sequence[Row]) -> None:
    """Print each kind of names with its count and an example."""
    print_table(Table(_KIND_COLUMNS, [dict(row) for row in kinds]), console())
    print("One kind: flipperctl list KIND")


def print_names(listed: Sequence[Row], titles: Mapping[str, str]) -> None:
    """Print a line for each name, in a table for each group; ``titles``: its command."""
    for group, title in titles.items():
        rows = [dict(row) for row in listed if row["group"] == group]
        print_table(Table(_NAME_COLUMNS, rows, title), console())
    if listed:
        print(f"More about one: flipperctl explain {listed[0]['name']}")


def print_runs(folder: Path, listed: Sequence[Row]) -> None:
    """Print a line for each run below a folder."""
    rows = []
    for row in listed:
        rate, terrain = row["success_rate"], row["terrain"] or NONE
        success = NONE if rate is None else percent(rate)
        rows.append({**row, "success": success, "terrain": terrain})
    print_table(Table(_RUN_COLUMNS, rows, f"{folder}: {counted(len(rows), 'run')}"), console())


def print_explained(document: Row) -> None:
    """Print what ``explain`` found: a word's meaning, names, settings, or hits of a search."""
    out = console()
    if document["meaning"]:
        print_lines(out, [f"{document['word']}: {document['meaning']}"])
    for line in document["lines"]:
        print_facts({"write": line}, out)
    several = len(document["names"]) > 1
    for entry in document["names"]:
        _print_entry(entry, brief=several)
    if several:
        last = document["names"][-1]
        print(f"More about one: flipperctl explain {last['group']}={last['name']}")
    if len(document["settings"]) == 1:
        _print_setting(document["settings"][0])
    elif settings := document["settings"]:
        columns = Column("key", "setting", named=True), Column("of", "of", named=True)
        rows = [_cells(setting) | {"description": setting["short"]} for setting in settings]
        print_table(Table((*columns, *_FIELD_COLUMNS), rows), out)
        print(f"More about one: flipperctl explain {settings[0]['alias']}")
    if document["found"]:
        title = f"found for {document['word']!r}"
        print_table(Table(_HIT_COLUMNS, [dict(hit) for hit in document["found"]], title), out)
        print(f"More about one: {_more(document['found'][0])}")


def _more(hit: Row) -> str:
    name = str(hit["name"])
    return f"{name} --help" if hit["kind"] == "command" else f"flipperctl explain {name}"


def _print_entry(entry: Row, *, brief: bool) -> None:
    """Print a plugin with its settings, or a preset with what it sets; ``brief``: what it is."""
    # What it is, how it is written, and what it sets
    out, plugin = console(), entry.get("plugin")
    about = entry["summary"] if brief else entry["about"] or entry["summary"]
    print_lines(out, [f"{entry['name']} ({entry['group']}): {about}"])
    if brief:
        print_facts({"write": entry["command"]}, out)
        return
    print_facts(
        {"write": entry["command"], **({"source": plugin["source"]} if plugin else {})}, out
    )
    if plugin and plugin["fields"]:
        columns = (Column("name", "setting", named=True), *_FIELD_COLUMNS)
        print_table(Table(columns, [_cells(field) for field in plugin["fields"]]), out)
    if entry["settings"]:
        rows = [{"key": key, "value": value} for key, value in entry["settings"].items()]
        print_table(Table(_PRESET_COLUMNS, rows), out)


def _print_setting(setting: Row) -> None:
    out = console()
    default = override_text(setting["default"])
    if setting["train"] not in (None, setting["default"]):
        default += f"; flipperctl train has {override_text(setting['train'])}"
    facts = {
        "default": default,
        "allowed": setting["bounds"] or "any",
        "unit": setting["unit"] if setting["unit"] not in ("-", "") else "none",
        "part of": f"{setting['of']} ({setting['class']})",
        "set by": ", ".join(f"{name} ({value})" for name, value in setting["set_by"].items()),
        "write": setting["command"],
    }
    print_lines(out, [f"{setting['key']}: {setting['description']}"])
    print_facts({name: text for name, text in facts.items() if text}, out)


def _cells(row: Row) -> dict[str, Any]:
    """Return the cells of a row of ``_FIELD_COLUMNS``."""
    unit = "" if row["unit"] == "-" else row["unit"]
    return {**row, "default": override_text(row["default"]), "unit": unit}
