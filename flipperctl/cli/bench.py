"""``flipperctl bench``, and how measures of any suite are run."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flipperctl.cli.command import TrainingCommand
from flipperctl.cli.options import AsJson, PluginPaths
from flipperctl.errors import ConfigError, RequestError

if TYPE_CHECKING:
    from flipperctl.bench.settings import BenchSettings, Sizes, Suite
    from flipperctl.config import TrainConfig

MEASURES = ("engines", "learner", "latency", "scaling")
MOVED = ("physics", "accuracy", "lookahead", "solve", "startup", "discovery")
"""Measures of version 0.2 that are run in a clone of the repository since."""
SECTION = "bench."

COMMAND = TrainingCommand
HELP = """Measure how fast flipperctl is on this machine.

[bold]engines[/] simulated time per CPU time of each engine, alone and in the environment;
[bold]learner[/] updates per second;
[bold]latency[/] an exported policy, checkpoints, memory of a training;
[bold]scaling[/] over collecting processes. Contestants run in turn; medians with quartiles.

OVERRIDES are those of train and bench.<key>=…: repeats, seed, controller, episodes, families,
updates, batch_sizes, transitions, calls, decisions.

[bold]Examples[/]

  flipperctl bench engines learner

  flipperctl bench --small --json

  flipperctl bench scaling bench.decisions=5000 terrain=step --output speed
"""

Small = Annotated[
    bool, typer.Option("--small", help="Run everything in seconds, to test that it works.")
]
Repeats = Annotated[
    str | None, typer.Option(metavar="N", help="Rounds in which contestants take turns [10].")
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
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.config.words import with_flags

    words = arguments or []
    for name in MOVED:
        if name in words:
            raise RequestError(
                f"the measure {name!r} is not installed any more; in a clone of the repository: "
                f"python -m benchmarks {name}"
            )
    measures, overrides = split_arguments(words, MEASURES)
    run_measures(
        suite(),
        measures,
        with_flags(overrides, SECTION.rstrip("."), repeats=repeats),
        small=small,
        output=output,
        as_json=as_json,
    )


def suite() -> Suite[BenchSettings]:
    """Return the installed measures."""
    from flipperctl.bench.settings import SMALL, BenchSettings, Suite

    return Suite("flipperctl.bench", MEASURES, BenchSettings, SMALL)


def run_measures(
    suite: Suite[Sizes],
    measures: Sequence[str],
    overrides: list[str],
    *,
    small: bool,
    output: Path | None,
    as_json: bool,
) -> None:
    """Run measures of a suite one after another; print their tables, or one JSON document.

    Raises:
        RequestError: the overrides are wrong, or ``output`` cannot be written.
    """
    from flipperctl.bench.machine import load, machine
    from flipperctl.bench.settings import Bench
    from flipperctl.files import write_json
    from flipperctl.runs.results import result_folder
    from flipperctl.terminal.bench import tables
    from flipperctl.terminal.console import console

    config, settings = compose_bench(suite, overrides, small=small)
    document: dict[str, Any] = {
        "machine": machine(),
        "settings": settings.model_dump(mode="json"),
        "overrides": overrides,
        "measures": {},
    }
    training_overrides = tuple(o for o in overrides if not o.startswith(SECTION))
    with ExitStack() as stack:
        folder = None
        if output:
            folder = stack.enter_context(result_folder(output, "bench", ["bench.json"]))
        for name in measures:
            with _progress(name) as report:
                inputs = Bench(config, settings, report, training_overrides)
                found = import_module(f"{suite.package}.{name}").measure(inputs)
            document["measures"][name] = {**found, "load_average": load()}
            for text in found.get("missing", ()):
                print(f"{name}: {text}", file=sys.stderr)
            if folder:  # after each, since the next may take an hour
                folder.replace(lambda part: write_json(part / "bench.json", document))
    if as_json:
        print(json.dumps(document, indent=2, allow_nan=False))
        return
    for table in tables(document):
        table.print(console())


def split_arguments(arguments: list[str], known: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the measures, in the order of those ``known``, and the overrides.

    Raises:
        RequestError: a word is neither of them.
    """
    from flipperctl.messages import close_match

    overrides = [a for a in arguments if "=" in a or a.startswith("~")]
    names = [a for a in arguments if a not in overrides]
    allowed = ("all", *known)
    for name in names:
        if name not in allowed:
            raise RequestError(
                f"there is no measure {name!r}{close_match(name, allowed)}; "
                f"known: {', '.join(allowed)}; an override is key=value"
            )
    every = not names or "all" in names
    return [m for m in known if every or m in names], overrides


def compose_bench(
    suite: Suite[Sizes], overrides: list[str], *, small: bool
) -> tuple[TrainConfig, Sizes]:
    """Return the training configuration and the sizes of the measures.

    Raises:
        ConfigError: an override is malformed, unknown or out of bounds, or a sweep.
    """
    from flipperctl.cli.hydra import compose, config_store
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.config import resolver
    from flipperctl.config.words import check_once

    check_once(overrides)
    own = [o.removeprefix(SECTION) for o in overrides if o.startswith(SECTION)]
    changes = Overrides.parse(own).values()
    try:
        settings = suite.settings(small=small, changes=changes)
    except ConfigError as error:
        raise ConfigError(f"{SECTION}{error}") from error
    resolver.get("controller", settings.controller, f"{SECTION}controller")
    config_store.register_defaults()
    configs = compose.compose_train(
        Overrides.parse(o for o in overrides if not o.startswith(SECTION))
    )
    if len(configs) > 1:
        raise ConfigError(f"bench measures one configuration; the overrides make {len(configs)}")
    return configs[0], settings


@contextmanager
def _progress(measure: str) -> Iterator[Callable[[str, float], None]]:
    """Show a bar with the time left on a terminal, occasional lines elsewhere."""
    from flipperctl.terminal.bench import Bar, Lines

    shown = Bar(measure) if sys.stderr.isatty() else Lines(measure)
    try:
        yield shown
    finally:
        shown.close()
