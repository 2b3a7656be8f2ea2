"""The tables of ``flipperctl inspect plugins``: fields of plugins, and results of their checks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.text import Text

from flipperctl.show import Column, Table, print_table
from flipperctl.spelling import spell_plainly
from flipperctl.terminal.console import console

_FIELDS = (
    Column("name", "  field", named=True),
    Column("default", "default", wrapped=True),
    Column("bounds", "bounds", wrapped=True),
    Column("unit", "unit"),
    Column("description", "meaning", wrapped=True),
)
_CHECKS = (
    Column("plugin", "plugin", named=True),
    Column("check", "check", wrapped=True),
    Column("state", "ok"),
    Column("seconds", "time [s]"),
)


def print_plugins(found: list[dict[str, Any]]) -> None:
    """Print each plugin with a table of its fields."""
    output = console()

    def text(words: object, style: str = "") -> Text:
        return Text(spell_plainly(str(words), output.encoding), style)

    for plugin in found:
        kind = f"  {plugin['kind']}  "
        output.print(text(plugin["name"], "bold") + text(kind) + text(plugin["summary"]))
        output.print(text(f"  {plugin['source']}", "dim"), soft_wrap=True)
        if plugin["fields"]:
            rows = [
                {
                    **field,
                    "name": f"  {field['name']}",
                    "default": f"{default:.4g}" if isinstance(default, float) else str(default),
                }
                for field in plugin["fields"]
                for default in (field["default"],)
            ]
            print_table(Table(_FIELDS, rows), output)
        output.print()


def print_checks(rows: Sequence[dict[str, Any]]) -> None:
    """Print a row for each check, and below them the messages."""
    output = console()
    cells = []
    last = ""
    for row in rows:
        plugin = f"{row['kind']} {row['name']}"
        state = "skipped" if row["skipped"] else "yes" if row["ok"] else "no"
        style = "bold red" if state == "no" else ""
        shown = {"plugin": "" if plugin == last else plugin, "state": state, "style": style}
        cells.append(row | shown)
        last = plugin
    print_table(Table(_CHECKS, cells), output)
    for row in rows:
        if row["message"]:
            output.print(f"{row['check']}: {row['message']}", markup=False, highlight=False)
