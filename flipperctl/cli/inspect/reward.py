"""``flipperctl inspect reward``: the audit of reward terms over rollouts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flipperctl.cli.options import AsJson, Overrides, PluginPaths
from flipperctl.errors import RequestError

if TYPE_CHECKING:
    from flipperctl.evaluation.audit import AuditResult

HELP = """Audit the reward: what each term pays over rollouts, and how often it saturates.

A term with a small share of the return has no effect; one that saturates at most steps carries no
information. The episodes are those of an evaluation, with conditions=… as for eval.

[bold]Examples[/]

  flipperctl inspect reward terrain=stair

  flipperctl inspect reward --checkpoint runs/stair/2026-01-31_12-00-00 rewards.pitch.lambda_2=8
"""


def add_to(app: typer.Typer) -> None:
    """Register the subcommand."""
    app.command("reward", help=HELP)(show)


def show(
    overrides: Overrides = None,
    checkpoint: Annotated[
        Path | None, typer.Option(metavar="RUN_OR_FILE", help="A run directory or a checkpoint.")
    ] = None,
    controller: Annotated[
        str | None, typer.Option(metavar="NAME", help="A controller plugin [okada].")
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes to play.")] = 20,
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    if checkpoint is not None and controller is not None:
        raise RequestError("give --checkpoint or --controller, not both")
    from flipperctl import plugins as loader
    from flipperctl.cli.compose import only_one
    from flipperctl.cli.progress import episodes_progress
    from flipperctl.cli.scenes import scenes
    from flipperctl.evaluation.audit import audit

    loader.load(plugins or ())
    chosen = None if checkpoint else controller or "okada"
    config, source = only_one(scenes(list(overrides or []), checkpoint, chosen))
    label = f"{config.terrain.plugin_name}, {source.label()}"
    with episodes_progress(label, episodes) as report:
        found = audit(config, source, episodes=episodes, report=report)
    if as_json:
        print(json.dumps(found.container(), indent=2))
    else:
        _print(found)


def _print(found: AuditResult) -> None:
    from rich.markup import escape
    from rich.table import Table

    from flipperctl.cli.conditions import condition_lines
    from flipperctl.cli.console import console

    title = (
        f"{found.controller} on {found.terrain}: {found.episodes} episodes, "
        f"{found.decisions} decisions, mean return {found.mean_return:.2f}"
    )
    table = Table(title=title, title_justify="left")
    table.add_column("term", no_wrap=True)
    for heading in ("weight", "mean a decision", "lowest", "highest"):
        table.add_column(escape(heading))
    table.add_column("share of the return")
    table.add_column("saturated")
    for name, term in found.terms.items():
        table.add_row(
            name,
            f"{term.weight:g}",
            *(f"{value:.4f}" for value in (term.mean, term.lowest, term.highest)),
            f"{term.share:.1%}",
            "–" if term.saturated is None else f"{term.saturated:.1%}",
        )
    console().print(table)
    for line in condition_lines([(found.terrain, found.seed, found.conditions)]):
        print(line)
