"""``flipperctl inspect run``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli.options import AsJson, PluginPaths

HELP = """Summarise a training run, and plot its learning curves with --output.

[bold]Examples[/]

  flipperctl inspect run runs/stair/2026-01-31_12-00-00 --output curves.png
"""


def run(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory.")],
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A picture: .png, .svg or .pdf.")
    ] = None,
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.runs.summary import RunRows, summarise
    from flipperctl.terminal.run import print_run

    rows = RunRows.read(run)
    if output is not None:
        from flipperctl.report.figure import save
        from flipperctl.report.learning import learning_figure

        save(learning_figure(rows.episodes, rows.validations, str(run)), output)
    found = summarise(run, rows)
    if as_json:
        print(json.dumps(found, indent=2))
        return
    print_run(found)
    if output is not None:
        print(f"picture: {output}")
