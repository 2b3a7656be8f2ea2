"""``flipperctl inspect run``."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Annotated, Any

import typer

from flipperctl.cli.options import AsJson, PluginPaths
from flipperctl.terminal.pitch_variation import HEADING, PAPERS_HEADING

HELP = """Summarise a training run, and plot its learning curves with --output.

[bold]Examples[/]

  flipperctl inspect run runs/stair/2026-01-31_12-00-00 --output curves.png
"""


def add_to(app: typer.Typer) -> None:
    """Register the subcommand."""
    app.command("run", help=HELP)(show)


def show(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory.")],
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A picture: .png, .svg or .pdf.")
    ] = None,
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl import plugins as loader
    from flipperctl.errors import RequestError
    from flipperctl.training.events import read_rows

    loader.load(plugins or ())
    metrics = run / "metrics.csv"
    if not metrics.is_file():
        raise RequestError(f"{run} holds no metrics.csv; is it a run directory?")
    rows = read_rows(metrics)
    episodes = [row for row in rows if row["kind"] == "episode"]
    validations = [row for row in rows if row["kind"] == "validation"]
    if output is not None:
        from flipperctl.report.figure import save
        from flipperctl.report.learning import learning_figure

        save(learning_figure(episodes, validations, str(run)), output)
    found = _summary(run, episodes, validations)
    if as_json:
        print(json.dumps(found, indent=2))
        return
    _print(found)
    if output is not None:
        print(f"picture: {output}")


def _summary(
    run: Path, episodes: list[dict[str, str]], validations: list[dict[str, str]]
) -> dict[str, Any]:
    summary_file = run / "summary.json"
    summary = json.loads(summary_file.read_text("utf-8")) if summary_file.is_file() else None
    swings = ("pitch_variation_100hz", "pitch_variation")
    keys = ("decision", "success_rate", *swings, "t_cost", "return")
    return {
        "run": str(run),
        "summary": summary,
        "episodes": len(episodes),
        "validations": [{k: _number(row.get(k)) for k in keys} for row in validations],
    }


def _number(cell: str | None) -> float | None:
    """Return the number in a cell; None if it is empty, or its column is of a later version."""
    return float(cell) if cell else None


def _resume_command(run: Path) -> str:
    """Return the command, with the names of plugin files that it lacks.

    A run knows the names of its plugins' files, not where they lie.
    """
    from flipperctl import checkpoint
    from flipperctl.errors import CheckpointError
    from flipperctl.runs import follow_up

    command = follow_up.command("train", "--resume", run)
    files: list[str] = []
    if not follow_up.plugin_paths():
        with contextlib.suppress(CheckpointError):  # train --resume says what is damaged
            named = checkpoint.read(run / checkpoint.LAST).document.plugins
            files = list(dict.fromkeys(p.origin for p in named if p.origin))
    return f"{command} (and --plugins for {', '.join(files)})" if files else command


def _print(found: dict[str, Any]) -> None:
    from flipperctl.terminal.console import console
    from flipperctl.terminal.tables import Table

    summary = found["summary"]
    state = "still running or interrupted" if not summary else "finished"
    if summary and not summary["finished"]:
        state = f"interrupted; resume with: {_resume_command(Path(found['run']))}"
    headings = ("decision", "success", HEADING, PAPERS_HEADING, "t_cost [s]", "return")
    table = Table(headings, f"{found['run']}: {state}", right=headings)
    for row in found["validations"]:
        swing = row["pitch_variation_100hz"]
        table.add(
            f"{row['decision']:.0f}",
            f"{row['success_rate']:.1%}",
            "–" if swing is None else f"{swing:.3f}",
            f"{row['pitch_variation']:.3f}",
            f"{row['t_cost']:.1f}",
            f"{row['return']:.2f}",
        )
    table.print(console())
