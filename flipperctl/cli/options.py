"""Options and arguments that several subcommands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import follow_up
from flipperctl.errors import RequestError
from flipperctl.messages import close_match


def _remember_plugins(paths: list[Path] | None) -> list[Path] | None:
    follow_up.remember_plugins(paths)
    return paths


PluginPaths = Annotated[
    list[Path] | None,
    typer.Option(
        "--plugins",
        metavar="PATH",
        help="A plugin file or folder; may be repeated.",
        callback=_remember_plugins,  # at every command, with None where it is not given
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Argument(metavar="OVERRIDE", help="key=value, as in terrain=stair agent.gamma=0.98."),
]
CheckpointFile = Annotated[
    Path | None,
    typer.Option(metavar="RUN_OR_FILE", help="A run, a checkpoint or an .onnx file."),
]
ControllerName = Annotated[
    str | None, typer.Option(metavar="NAME", help="A controller plugin, such as okada.")
]
Episodes = Annotated[str | None, typer.Option(metavar="N", help="Episodes per scene [100].")]
Seed = Annotated[str | None, typer.Option(metavar="N", help="Seed of the episodes [0].")]
Jobs = Annotated[str | None, typer.Option(metavar="N", help="Processes [1].")]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")]


def require_one_policy(checkpoint: Path | None, controller: str | None) -> None:
    """Check that exactly one of the two is given.

    Raises:
        RequestError: none or both are.
    """
    if (checkpoint is None) == (controller is None):
        raise RequestError("give either --checkpoint RUN_OR_FILE or --controller NAME")


def eval_overrides(**flags: str | None) -> list[str]:
    """Return the overrides of the section ``eval`` that the given flags stand for."""
    return [f"eval.{name}={value}" for name, value in flags.items() if value is not None]


def reject_options(arguments: list[str], known: list[str]) -> None:
    """Refuse unknown options among the overrides.

    Raises:
        RequestError: an argument begins with - and is not in ``known``.
    """
    for argument in arguments:
        name = argument.split("=")[0]
        if argument.startswith("-") and name not in known:
            raise RequestError(f"no such option: {name}{close_match(name, known)}")
