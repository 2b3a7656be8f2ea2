"""``flipperctl map``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options

HELP = """Map where a policy succeeds, over two settings.

A coarse grid is played first, and then the points where success changes. --over names two settings
with their ranges, LOW:HIGH or LOW:HIGH:VALUES; + joins settings with one common value. Repeat a
command with the same --output to play only what is missing.

[bold]Examples[/]

  flipperctl map okada terrain=uplift --over terrain.height,sim.friction

  flipperctl map generalist --over terrain.height=0.1:0.6:8,sim.friction
"""


def run(
    words: Annotated[
        list[str] | None,
        typer.Argument(metavar="POLICY [SETTING...]", help="A policy; key=value."),
    ] = None,
    over: Annotated[
        str | None,
        typer.Option(metavar="SETTINGS", help="Two settings, such as terrain.height,sim.friction."),
    ] = None,
    checkpoint: options.CheckpointFile = None,
    controller: options.ControllerName = None,
    episodes: Annotated[
        str | None, typer.Option(metavar="N", help="Episodes at each point [10].")
    ] = None,
    seed: options.Seed = None,
    jobs: options.Jobs = None,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the map and its picture.")
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.cli.plan import one_scene, player
    from flipperctl.config.words import with_default, with_flags
    from flipperctl.errors import InterruptedRunError, RequestError
    from flipperctl.evaluation.views import map as view
    from flipperctl.evaluation.views.axes import parse_axes
    from flipperctl.show import console, print_lines
    from flipperctl.terminal.streams import print_note, show

    if over is None:
        raise RequestError(f"name two settings, as in --over {view.EXAMPLE}")
    flagged = with_flags(words, episodes=episodes, seed=seed, jobs=jobs)
    flagged = with_default(flagged, "eval.episodes", view.EPISODES)
    entry = one_scene(flagged, checkpoint, controller, "map")
    if entry.config.eval.ray is not None:
        raise RequestError("eval.ray: a map is played here; leave it out")
    axes = parse_axes(over, entry.config)
    with player(output, "map", view.NAMES) as (plays, folder):
        for note in view.notes(entry, axes):
            print_note(note)
        found = view.capability_map(entry, axes, plays)

        def printed() -> None:
            print_lines(console(), view.lines(found))

        def written(part: Path) -> None:
            view.write(part, found)

        try:
            show(found.to_dict(), printed, as_json=as_json)
        finally:  # files are written even if the pipe is closed
            if folder is not None:
                folder.replace(written)
                print_note(f"saved to {folder.path}")
        if found.interrupted:
            raise InterruptedRunError(f"interrupted: {found.played} points are finished")
