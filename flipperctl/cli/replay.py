"""``flipperctl replay``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options

HELP = """Play a recorded failure once more, and check that it is the same bit for bit.

eval --output and map --output record failures as failure_….json.

[bold]Examples[/]

  flipperctl replay evaluated/failure_stair_3.json --film stair.gif
"""


def run(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recorded failure.")],
    checkpoint: Annotated[
        Path | None,
        typer.Option(metavar="RUN_OR_FILE", help="The policy, if it has moved since."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for replay.json and replay.png.")
    ] = None,
    film: Annotated[Path | None, typer.Option(metavar="FILE.gif", help="Film of it.")] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.errors import FlipperctlError
    from flipperctl.evaluation.replay import lines, replay_file
    from flipperctl.show import console, print_lines
    from flipperctl.terminal.progress import episodes_progress
    from flipperctl.terminal.streams import print_note, show

    found = replay_file(file, checkpoint, output, film, progress=episodes_progress, tell=print_note)
    show(found.to_dict(), lambda: print_lines(console(), lines(found)), as_json=as_json)
    if found.differences:
        raise FlipperctlError(
            f"{file}: the episode differs from the recorded one: {'; '.join(found.differences)}"
        )
