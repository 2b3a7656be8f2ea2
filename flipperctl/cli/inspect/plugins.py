"""``flipperctl inspect plugins``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flipperctl.cli import options

if TYPE_CHECKING:
    from flipperctl.api import Plugin

HELP = """List every registered plugin: its source, and its fields with default, bounds and unit.

With [bold]--check[/], run the conformance suite on them instead: terrains at every bound, rewards
on recorded episodes of every outcome, networks including their ONNX export, controllers within a
time limit, signs, frames, units and timing of engines and sensors.

[bold]Examples[/]

  flipperctl inspect plugins

  flipperctl inspect plugins stair --json

  flipperctl inspect plugins --plugins my_terrain.py

  flipperctl inspect plugins mine --check --plugins mine.py --output pictures
"""


def run(
    name: Annotated[str | None, typer.Argument(help="Only the plugins of this name.")] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Run the conformance suite; fail if a check fails.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="With --check: a folder for pictures of the terrains."),
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.api import registry
    from flipperctl.config.describe import describe_plugin, plugin_keys
    from flipperctl.errors import RequestError
    from flipperctl.terminal.streams import show
    from flipperctl.terminal.tables import print_plugins

    if output is not None and not check:
        raise RequestError("--output needs --check; inspect terrain draws a single picture")

    chosen = plugin_keys(name)
    if check:
        _check([registry[key] for key in chosen], output, as_json=as_json)
        return
    found = [describe_plugin(*key) for key in chosen]
    show(found, lambda: print_plugins(found), as_json=as_json)


def _check(plugins: list[type[Plugin]], pictures: Path | None, *, as_json: bool) -> None:
    from flipperctl.terminal.progress import steps_progress
    from flipperctl.terminal.streams import show
    from flipperctl.terminal.tables import print_checks
    from flipperctl.testing import checks
    from flipperctl.testing.check import require_passed, run_checks

    with steps_progress("check") as report:
        rows = run_checks(checks(*plugins, pictures=pictures), report)
    show(rows, lambda: print_checks(rows), as_json=as_json)
    require_passed(rows)
