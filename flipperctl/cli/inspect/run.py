"""``flipperctl inspect run``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options

HELP = """Summarise a training run, and plot its learning curves with --output.

[bold]Examples[/]

  flipperctl inspect run runs/stair/2026-01-31_12-00-00 --output curves.png
"""


def run(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory.")],
    output: options.Picture = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.terminal.run import print_run
    from flipperctl.terminal.streams import show
    from flipperctl.training.folder import RunRows, summarise

    rows = RunRows.read(run)
    if output is not None:
        from flipperctl.figures.figure import save
        from flipperctl.figures.learning import learning_figure

        save(learning_figure(rows.episodes, rows.validations, str(run)), output)
    found = summarise(run, rows)
    show(found, lambda: print_run(found, output), as_json=as_json)
