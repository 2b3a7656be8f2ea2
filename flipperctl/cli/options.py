"""Options and arguments that several subcommands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.errors import RequestError
from flipperctl.messages import close_match

PluginPaths = Annotated[
    list[Path] | None,
    typer.Option("--plugins", metavar="PATH", help="A plugin file or folder; may be repeated."),
]
Overrides = Annotated[
    list[str] | None,
    typer.Argument(metavar="OVERRIDE", help="key=value, as in terrain=stair agent.gamma=0.98."),
]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")]


def reject_options(arguments: list[str], known: list[str]) -> None:
    """Refuse unknown options among the overrides.

    Raises:
        RequestError: an argument begins with - and is not in ``known``.
    """
    for argument in arguments:
        name = argument.split("=")[0]
        if argument.startswith("-") and name not in known:
            raise RequestError(f"no such option: {name}{close_match(name, known)}")
