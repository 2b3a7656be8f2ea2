"""The output of ``flipperctl inspect run``: the validations of a run, and its state."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

from flipperctl import checkpoint, session
from flipperctl.errors import CheckpointError
from flipperctl.show import Column, Table, print_table
from flipperctl.terminal.console import console
from flipperctl.terminal.progress import HEADING, PAPERS_HEADING

_COLUMNS = (
    Column("decision", "decision", named=True),
    Column("success", "success"),
    Column("pitch_variation_100hz", HEADING, 3),
    Column("pitch_variation", PAPERS_HEADING, 3),
    Column("t_cost", "t_cost [s]", 1),
    Column("return", "return"),
)


def print_run(found: dict[str, Any], picture: Path | None) -> None:
    """Print a row for each validation (``training.folder.summarise``), and the picture's name."""
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
    print_table(Table(_COLUMNS, rows, f"{found['run']}: {state}"), console())
    if picture is not None:
        print(f"picture: {picture}")


def _resume_command(run: Path) -> str:
    """Return the command that resumes the run, and the names of plugin files to be added to it.

    A run records the names of its plugins' files, but not their folders.
    """
    command = session.command("train", "--resume", run)
    files: list[str] = []
    if not session.plugin_paths():
        with contextlib.suppress(CheckpointError):  # train --resume says what is damaged
            named = checkpoint.read(run / checkpoint.LAST).document.plugins
            files = list(dict.fromkeys(p.file for p in named if p.file))
    return f"{command} (and --plugins for {', '.join(files)})" if files else command
