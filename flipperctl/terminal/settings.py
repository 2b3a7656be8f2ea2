"""The tables of ``flipperctl inspect config --describe``, one for each section."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import Any

from rich.text import Text

from flipperctl.terminal.console import console
from flipperctl.terminal.tables import Table


def print_settings(found: Iterable[dict[str, Any]]) -> None:
    """Print a table per section; values that differ from the default are bold."""
    out = console(natural=120)
    headings = ("setting", "value", "default", "bounds", "unit", "meaning")
    for section, settings in groupby(found, key=lambda s: str(s["section"])):
        table = Table(headings, words=["value", "default", "bounds", "meaning"], boxed=False)
        for s in settings:
            value, default = _format_value(s["value"]), _format_value(s["default"])
            path = s["path"].removeprefix(f"{section}.")
            table.add(
                path,
                Text(value, "" if value == default else "bold"),
                *(default, s["bounds"], s["unit"], str(s["description"])),
            )
        out.print(Text(section or "top level", "bold"))
        table.print(out)
        out.print()


def _format_value(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, list):
        return f"[{', '.join(map(_format_value, value))}]"
    if isinstance(value, dict):
        if "name" in value:  # a plugin's fields have their own rows
            return str(value["name"])
        return ", ".join(f"{k}: {_format_value(v)}" for k, v in value.items()) or "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
