"""``flipperctl inspect plugins --check``: the conformance suite on registered plugins."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flipperctl.api import Plugin
from flipperctl.errors import ConformanceError
from flipperctl.testing import Check, NotChecked, checks


def check(plugins: Sequence[type[Plugin]], pictures: Path | None, *, as_json: bool) -> None:
    """Run every check and print the results.

    Raises:
        ConformanceError: a check failed; the text names plugins and checks.
    """
    from flipperctl.terminal.bench import Bar, Lines

    todo = checks(*plugins, pictures=pictures)
    shown = Bar("check") if sys.stderr.isatty() else Lines("check")
    try:
        rows = []
        for index, one in enumerate(todo):
            shown(str(one), index / len(todo))
            rows.append(run_check(one))
    finally:
        shown.close()
    if as_json:
        print(json.dumps(rows, indent=2))
    else:
        _print(rows)
    if failed := [f"{row['kind']} {row['name']} ({row['check']})" for row in rows if not row["ok"]]:
        raise ConformanceError(
            f"{len(failed)} of {len(rows)} checks failed: {', '.join(failed[:10])}"
            + (" …" if len(failed) > 10 else "")
        )


def run_check(one: Check) -> dict[str, Any]:
    """Run one check; return ``ok``, ``skipped``, the message and the time taken [s]."""
    begun, text, ok, skipped = time.perf_counter(), "", True, False
    try:
        one()
    except ConformanceError as error:
        text, ok = str(error), False
    except NotChecked as error:
        text, skipped = str(error), True
    return {
        "kind": one.plugin.kind,
        "name": getattr(one.plugin, "plugin_name", one.plugin.__name__),
        "check": one.name,
        "ok": ok,
        "skipped": skipped,
        "message": text,
        "seconds": time.perf_counter() - begun,
    }


def _print(rows: Sequence[dict[str, Any]]) -> None:
    from rich.text import Text

    from flipperctl.terminal.console import console
    from flipperctl.terminal.tables import Table

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
