"""The table of ``flipperctl inspect conventions``."""

from __future__ import annotations

from flipperctl.evaluation.conventions import Probe
from flipperctl.show import Column, Table, print_table
from flipperctl.terminal.console import console

_COLUMNS = (
    Column("of", "probed", named=True),
    Column("meaning", "convention", wrapped=True),
    Column("found", "found"),
    Column("expected", "expected"),
    Column("holds", ""),
)


def print_probes(found: list[Probe]) -> None:
    """Print a row for each convention."""
    rows = [
        {
            "of": probe.of,
            "meaning": probe.meaning,
            "found": f"{probe.found:.3f}{unit}",
            "expected": f"{probe.expected:.3f} ± {probe.tolerance:.3f}{unit}",
            "holds": "holds" if probe.holds else "WRONG",
        }
        for probe in found
        for unit in ("" if probe.unit == "-" else f" {probe.unit}",)
    ]
    print_table(Table(_COLUMNS, rows), console())
