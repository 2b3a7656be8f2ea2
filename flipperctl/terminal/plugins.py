"""The tables of ``flipperctl inspect plugins``: fields of plugins, and results of their checks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.text import Text

from flipperctl.terminal.console import console, plain
from flipperctl.terminal.tables import Table


def print_plugins(found: list[dict[str, Any]]) -> None:
    """Print each plugin with a table of its fields."""
    output = console()

    def text(words: object, style: str = "") -> Text:
        return Text(plain(str(words), output), style)

    for plugin in found:
        kind = f"  {plugin['kind']}  "
        output.print(text(plugin["name"], "bold") + text(kind) + text(plugin["summary"]))
        output.print(text(f"  {plugin['source']}", "dim"), soft_wrap=True)
        if plugin["fields"]:
            headings = ("  field", "default", "bounds", "unit", "meaning")
            table = Table(headings, words=["default", "bounds", "meaning"], boxed=False)
            for field in plugin["fields"]:
                default = field["default"]
                shown = f"{default:.4g}" if isinstance(default, float) else str(default)
                cells = (f"  {field['name']}", shown, field["bounds"], field["unit"])
                table.add(*cells, field["description"])
            table.print(output)
        output.print()


def print_checks(rows: Sequence[dict[str, Any]]) -> None:
    """Print a row for each check, and below them the messages."""
    output = console()
    headings = ("plugin", "check", "ok", "time [s]")
    table = Table(headings, right=["time [s]"], words=["check"], boxed=False)
    last = ""
    for row in rows:
        plugin = f"{row['kind']} {row['name']}"
        state = "skipped" if row["skipped"] else "yes" if row["ok"] else Text("no", "bold red")
        table.add("" if plugin == last else plugin, row["check"], state, f"{row['seconds']:.2f}")
        last = plugin
    table.print(output)
    for row in rows:
        if row["message"]:
            output.print(f"{row['check']}: {row['message']}", markup=False, highlight=False)
