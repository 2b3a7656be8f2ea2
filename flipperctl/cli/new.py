"""``flipperctl new``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options

KINDS = ("terrain", "reward", "network", "controller", "engine", "sensor", "measure", "logger")

HELP = """Write a plugin as a starting point: one file, or with --package an installable project.

KIND is terrain, reward, network, controller, engine, sensor, measure or logger. The plugin works
as written and passes the conformance suite. Existing files are never overwritten.

[bold]Examples[/]

  flipperctl new terrain mine

  flipperctl new reward calm --output plugins

  flipperctl new controller brave --package

  flipperctl new engine glider
"""


def run(
    kind: Annotated[str, typer.Argument(metavar="KIND", help=", ".join(KINDS) + ".")],
    name: Annotated[
        str,
        typer.Argument(
            help="Name of the plugin: lower-case letters, digits and _.", show_default=False
        ),
    ],
    package: Annotated[
        bool,
        typer.Option("--package", help="Write a project with pyproject, source, test and README."),
    ] = False,
    output: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder to write to.", show_default=False)
    ] = Path(),
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.scaffold.draft import Draft, next_commands

    draft = Draft(kind, name)
    made = draft.write_package(output) if package else draft.write_file(output)
    print(f"wrote {made}; next:")
    for command in next_commands(draft, made, package=package):
        print(f"  {command}")
