"""The tables of ``flipperctl inspect config --describe``, one for each section."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import Any

from flipperctl.show import NONE, Column, Table, print_table
from flipperctl.terminal.console import console

_COLUMNS = (
    Column("path", "setting", named=True),
    Column("value", "value", wrapped=True),
    Column("default", "default", wrapped=True),
    Column("bounds", "bounds", wrapped=True),
    Column("unit", "unit"),
    Column("description", "meaning", wrapped=True),
)


def print_settings(found: Iterable[dict[str, Any]]) -> None:
    """Print a table per section; values that differ from the default are bold."""
    out = console(natural=120)
    for section, settings in groupby(found, key=lambda s: str(s["section"])):
        rows = []
        for s in settings:
            value, default = _format_value(s["value"]), _format_value(s["default"])
            shown = {"path": s["path"].removeprefix(f"{section}."), "value": value}
            style = "" if value == default else "bold"
            rows.append(s | shown | {"default": default, "style": style})
        print_table(Table(_COLUMNS, rows, section or "top level"), out)
        out.print()


def _format_value(value: object) -> str:
    if value is None:
        return NONE
    if isinstance(value, list):
        return f"[{', '.join(map(_format_value, value))}]"
    if isinstance(value, dict):
        if "name" in value:  # a plugin's fields have their own rows
            return str(value["name"])
        return ", ".join(f"{k}: {_format_value(v)}" for k, v in value.items()) or NONE
    return f"{value:.4g}" if isinstance(value, float) else str(value)
