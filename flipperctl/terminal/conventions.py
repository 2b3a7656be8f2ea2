"""The table of ``flipperctl inspect conventions``."""

from __future__ import annotations

from flipperctl.studies.conventions import Probe
from flipperctl.terminal.console import console
from flipperctl.terminal.tables import Table


def print_probes(found: list[Probe]) -> None:
    """Print a row for each convention."""
    headings = ("probed", "convention", "found", "expected", "")
    table = Table(headings, words=["convention"])
    for probe in found:
        unit = "" if probe.unit == "-" else f" {probe.unit}"
        table.add(
            probe.of,
            probe.meaning,
            f"{probe.found:.3f}{unit}",
            f"{probe.expected:.3f} ± {probe.tolerance:.3f}{unit}",
            "holds" if probe.holds else "WRONG",
        )
    table.print(console())
