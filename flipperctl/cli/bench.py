"""``flipperctl bench``, and the command line of any other suite of measures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flipperctl.cli import options
from flipperctl.cli.command import TrainingCommand

if TYPE_CHECKING:
    from flipperctl.bench.settings import Bench, BenchSettings, Sizes, Suite

MEASURES = ("engines", "learner", "latency", "scaling")

COMMAND = TrainingCommand
HELP = """Measure how fast flipperctl is on this machine.

[bold]engines[/] simulated time per CPU time of each engine, alone and in the environment;
[bold]learner[/] updates per second;
[bold]latency[/] an exported policy, checkpoints, memory of a training;
[bold]scaling[/] decisions per second by worker processes. Contestants run in turn; the tables show
medians with quartiles.

OVERRIDES are those of train and bench.<key>=…: repeats, seed, controller, episodes, families,
updates, batch_sizes, transitions, calls, decisions, workers.

[bold]Examples[/]

  flipperctl bench engines learner

  flipperctl bench --small --json

  flipperctl bench scaling bench.decisions=5000 terrain=step --output speed
"""

Small = Annotated[bool, typer.Option("--small", help="Run all in seconds, to test that it works.")]
Repeats = Annotated[
    str | None, typer.Option(metavar="N", help="Rounds, each with all contestants [10].")
]
OutputFolder = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for bench.json.")]


def run(
    arguments: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MEASURE]... [OVERRIDE]...",
            help=f"all, {', '.join(MEASURES)}; and key=value.",
            show_default=False,
        ),
    ] = None,
    small: Small = False,
    repeats: Repeats = None,
    output: OutputFolder = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    run_suite(suite(), arguments or [], repeats, small=small, output=output, as_json=as_json)


def suite() -> Suite[BenchSettings]:
    """Return the installed measures."""
    from flipperctl.bench.settings import SMALL, BenchSettings, Suite

    return Suite("flipperctl.bench", MEASURES, BenchSettings, SMALL)


def run_suite(
    suite: Suite[Sizes],
    words: Sequence[str],
    repeats: str | None,
    *,
    small: bool,
    output: Path | None,
    as_json: bool,
) -> None:
    """Run the measures named by the words; print their tables, or one JSON document.

    Raises:
        RequestError: a word is wrong, or ``output`` cannot be written.
    """
    from flipperctl.bench.measures import run_measures, split_arguments
    from flipperctl.config.words import with_flags
    from flipperctl.terminal.progress import steps_progress
    from flipperctl.terminal.streams import print_note, show
    from flipperctl.terminal.tables import print_measures

    measures, typed = split_arguments(words, suite.measures)
    overrides = with_flags(typed, "bench", repeats=repeats)
    document = run_measures(
        *(suite.package, measures, _inputs(suite, overrides, small=small), overrides),
        output=output,
        progress=steps_progress,
        tell=print_note,
    )
    show(document, lambda: print_measures(document), as_json=as_json)


def _inputs(suite: Suite[Sizes], words: Sequence[str], *, small: bool) -> Bench[Sizes]:
    """Return the training configuration and the sizes of the measures.

    Raises:
        ConfigError: an override is malformed, unknown or out of bounds, or a sweep.
    """
    from flipperctl.bench.settings import SECTION, Bench
    from flipperctl.cli.hydra.compose import compose_train, only_one
    from flipperctl.cli.hydra.overrides import Overrides

    overrides = Overrides.parse(words)
    own = overrides.where(lambda key: key.startswith(SECTION)).values()
    changes = {key.removeprefix(SECTION): value for key, value in own.items()}
    settings = suite.settings(small=small, changes=changes)
    others = overrides.where(lambda key: not key.startswith(SECTION))
    return Bench(only_one(compose_train(others)), settings, overrides=tuple(others.words))
