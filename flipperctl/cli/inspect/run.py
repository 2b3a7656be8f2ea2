"""``flipperctl inspect run``."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Annotated, Any

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
    from flipperctl.terminal.streams import show
    from flipperctl.training.folder import RunRows, summarise

    rows = RunRows.read(run)
    if output is not None:
        from flipperctl.figures.figure import save
        from flipperctl.figures.learning import learning_figure

        save(learning_figure(rows.episodes, rows.validations, str(run)), output)
    found = summarise(run, rows)
    show(found, lambda: _print(found, output), as_json=as_json)


def _print(found: dict[str, Any], picture: Path | None) -> None:
    """Print a row for each validation (``training.folder.summarise``), and the picture's name."""
    from flipperctl.show import Column, Table, console, print_table
    from flipperctl.terminal.progress import HEADING, PAPERS_HEADING

    summary = found["summary"]
    state = "still running" if found["running"] else "finished"
    if not (found["running"] or (summary and summary["finished"])):
        ended = "interrupted" if summary else "ended by an error, or killed"
        state = f"{ended}; resume with: {_resume_command(Path(found['run']))}"
    rows = [
        row
        | {
            "decision": f"{row['decision']:.0f}",
            "success": f"{row['success_rate']:.1%}",
            "return": row["return"] if row["mean_return"] is None else row["mean_return"],
        }
        for row in found["validations"]
    ]
    columns = (
        Column("decision", "decision", named=True),
        Column("success", "success"),
        Column("pitch_variation_100hz", HEADING, 3),
        Column("pitch_variation", PAPERS_HEADING, 3),
        Column("t_cost", "t_cost [s]", 1),
        Column("return", "return"),
    )
    print_table(Table(columns, rows, f"{found['run']}: {state}"), console())
    if picture is not None:
        print(f"picture: {picture}")


def _resume_command(run: Path) -> str:
    """Return the command that resumes the run, and the names of plugin files to be added to it.

    A run records the names of its plugins' files, but not their folders.
    """
    from flipperctl import checkpoint, session
    from flipperctl.errors import CheckpointError

    command = session.command("train", "--resume", run)
    files: list[str] = []
    if not session.plugin_paths():
        with contextlib.suppress(CheckpointError):  # train --resume says what is damaged
            named = checkpoint.read(run / checkpoint.LAST).document.plugins
            files = list(dict.fromkeys(p.file for p in named if p.file))
    return f"{command} (and --plugins for {', '.join(files)})" if files else command
