"""``flipperctl bench``."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flipperctl.cli.command import TrainingCommand
from flipperctl.cli.options import AsJson, PluginPaths
from flipperctl.errors import ConfigError, RequestError

if TYPE_CHECKING:
    from flipperctl.bench.settings import Bench, BenchSettings
    from flipperctl.config import TrainConfig

MEASURES = (
    *("physics", "engines", "accuracy", "lookahead", "learner", "solve"),
    *("latency", "startup", "discovery", "scaling"),
)
SECTION = "bench."

COMMAND = TrainingCommand
HELP = """Measure how fast flipperctl is on this machine, against its limits and another learner.

[bold]physics[/] the environment against Chipmunk alone; [bold]engines[/] simulated time per CPU
time of each engine; [bold]accuracy[/] of the substep;
[bold]lookahead[/] decisions of mpc, and its prediction model against environment and engine;
[bold]learner[/] updates against Stable-Baselines3's DQN; [bold]solve[/] time until unseen episodes
succeed, against it too;
[bold]latency[/] an exported policy, checkpoints, memory; [bold]startup[/] of each command;
[bold]discovery[/] of installed plugins;
[bold]scaling[/] over collecting processes. Contestants run in turn; medians with quartiles.

OVERRIDES are those of train and bench.<key>=…: repeats, seed, controller, episodes, starts,
families, updates, batch_sizes, transitions, seeds, limit, validate_every, validation_episodes,
in_a_row, calls, decisions, commands, modules.

[bold]Examples[/]

  flipperctl bench physics learner

  flipperctl bench --small --json

  flipperctl bench solve bench.seeds=3 bench.limit=300 terrain=step --output speed
"""


def run(
    context: typer.Context,
    arguments: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MEASURE]... [OVERRIDE]...",
            help=f"all, {', '.join(MEASURES)}; and key=value.",
            show_default=False,
        ),
    ] = None,
    small: Annotated[
        bool, typer.Option("--small", help="Run everything in seconds, to test that it works.")
    ] = False,
    repeats: Annotated[
        str | None, typer.Option(metavar="N", help="Rounds in which contestants take turns [10].")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for bench.json.")
    ] = None,
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    measures, overrides = split_arguments(arguments or [])
    from flipperctl.bench.machine import load, machine
    from flipperctl.bench.settings import Bench
    from flipperctl.config.words import with_flags
    from flipperctl.files import write_json
    from flipperctl.runs.results import result_folder
    from flipperctl.terminal.bench import tables

    overrides = with_flags(overrides, SECTION.rstrip("."), repeats=repeats)
    config, settings = compose_bench(overrides, small=small)
    document: dict[str, Any] = {
        "machine": machine(),
        "settings": settings.model_dump(mode="json"),
        "overrides": overrides,
        "measures": {},
    }
    commands = startup_commands(context)
    training_overrides = tuple(o for o in overrides if not o.startswith(SECTION))
    with ExitStack() as stack:
        folder = None
        if output:
            folder = stack.enter_context(result_folder(output, "bench", ["bench.json"]))
        for measure in measures:
            with _progress(measure) as report:
                bench = Bench(config, settings, report, training_overrides)
                found = _measure(measure, bench, commands)
            document["measures"][measure] = {**found, "load_average": load()}
            for text in found.get("missing", ()):
                print(f"{measure}: {text}", file=sys.stderr)
            if folder:  # after each, since the next may take an hour
                folder.replace(lambda part: write_json(part / "bench.json", document))
    if as_json:
        print(json.dumps(document, indent=2, allow_nan=False))
        return
    from flipperctl.terminal.console import console

    for table in tables(document):
        table.print(console())


def split_arguments(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Return the measures, in the order of ``MEASURES``, and the overrides.

    Raises:
        RequestError: a word is neither of them.
    """
    from flipperctl.messages import close_match

    overrides = [a for a in arguments if "=" in a or a.startswith("~")]
    names = [a for a in arguments if a not in overrides]
    for name in names:
        if name != "all" and name not in MEASURES:
            known = ("all", *MEASURES)
            raise RequestError(
                f"there is no measure {name!r}{close_match(name, known)}; "
                f"known: {', '.join(known)}; an override is key=value"
            )
    every = not names or "all" in names
    return [m for m in MEASURES if every or m in names], overrides


def compose_bench(overrides: list[str], *, small: bool) -> tuple[TrainConfig, BenchSettings]:
    """Return the training configuration and the benchmark's own settings.

    Raises:
        ConfigError: an override is malformed, unknown or out of bounds, or a sweep.
    """
    from flipperctl.bench.settings import sizes
    from flipperctl.cli.hydra import compose, config_store
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.config import resolver
    from flipperctl.config.words import check_once

    check_once(overrides)
    own = [o.removeprefix(SECTION) for o in overrides if o.startswith(SECTION)]
    changes = Overrides.parse(own).values()
    try:
        settings = sizes(small=small, changes=changes)
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


def startup_commands(context: typer.Context) -> list[tuple[str, ...]]:
    """Return the commands that startup measures: every subcommand's help and two short ones."""
    helps: list[tuple[str, ...]] = []

    def visit(command: Any, path: tuple[str, ...]) -> None:
        helps.append((*path, "--help"))
        for name, inner in getattr(command, "commands", {}).items():
            visit(inner, (*path, name))

    visit(context.find_root().command, ())
    return [*helps, ("inspect", "plugins"), ("inspect", "terrain", "stair", "--json")]


def _measure(name: str, settings: Bench, commands: list[tuple[str, ...]]) -> dict[str, Any]:
    from importlib import import_module

    module = import_module(f"flipperctl.bench.{name}")
    found: dict[str, Any] = (
        module.measure(settings, commands) if name == "startup" else module.measure(settings)
    )
    return found


@contextmanager
def _progress(measure: str) -> Iterator[Callable[[str, float], None]]:
    """Show a bar with the time left on a terminal, occasional lines elsewhere."""
    from flipperctl.terminal.bench import Bar, Lines

    shown = Bar(measure) if sys.stderr.isatty() else Lines(measure)
    try:
        yield shown
    finally:
        shown.close()
