"""Options and arguments that several subcommands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def _load_plugins(context: typer.Context, paths: list[Path] | None) -> list[Path] | None:
    """Load the installed plugins and those of ``paths`` before the command runs."""
    if not context.resilient_parsing:  # shell completion
        from flipperctl.api.plugin import broken
        from flipperctl.plugging import plugins
        from flipperctl.process import session
        from flipperctl.terminal.streams import print_note

        session.remember_plugins(paths)
        plugins.load(paths or ())
        for package in dict.fromkeys(entry.package for entry in broken):
            print_note(f"warning: {package} does not load; flipperctl list plugins says why")
    return paths


def check_picture(path: Path | None) -> Path | None:
    """Check that the picture can be written before the command runs."""
    if path is not None:
        from flipperctl.figures.figure import PICTURE
        from flipperctl.text.files import check_output

        check_output(path, PICTURE)
    return path


PluginPaths = Annotated[
    list[Path] | None,
    typer.Option(
        "--plugins",
        metavar="PATH",
        help="A plugin file or folder; may be repeated.",
        callback=_load_plugins,  # called by every command, with None without the option
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Argument(metavar="OVERRIDE", help="key=value, as in terrain=stair agent.gamma=0.98."),
]
Picture = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="A picture: .png, .svg or .pdf.", callback=check_picture),
]
Episodes = Annotated[str | None, typer.Option(metavar="N", help="Episodes per scene [100].")]
Seed = Annotated[str | None, typer.Option(metavar="N", help="Seed of the episodes [0].")]
Jobs = Annotated[str | None, typer.Option(metavar="N", help="Processes [1].")]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")]
