"""``flipperctl export``."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import RequestError

HELP = """Write a policy for the robot: [bold]onnx[/], or [bold]pt2[/] (torch.export).

Before the file is saved, it is compared with torch on at least 1,000 observations of real rollouts;
a mismatch is an error.

OVERRIDES are settings of the target robot that differ from the training, as in
robot.angle_limit=0.9; the command prints the changes.

[bold]Examples[/]

  flipperctl export onnx --checkpoint runs/stair/2026-01-31_12-00-00 --output stair.onnx

  flipperctl export pt2 --checkpoint best.safetensors

  flipperctl export onnx --checkpoint generalist --output mine.onnx robot.flipper_speed=0.5
"""


class Kind(StrEnum):
    """File formats of an exported policy."""

    onnx = "onnx"
    pt2 = "pt2"


def run(
    kind: Annotated[Kind, typer.Argument(help="The format.")],
    checkpoint: Annotated[
        Path, typer.Option(metavar="RUN_OR_FILE", help="A run directory or a checkpoint.")
    ],
    overrides: options.Overrides = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="[<terrain>.<format>]", show_default=False)
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl import checkpoint as checkpoints
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.export.policy import export, robot_fields
    from flipperctl.files import check_writable
    from flipperctl.runs.inherited import find_policy
    from flipperctl.terminal.document import show
    from flipperctl.terminal.export import print_export
    from flipperctl.terminal.streams import print_note

    file = find_policy(checkpoint, print_note)
    if file.suffix == ".onnx":
        raise RequestError(f"{file} is already exported; give its run or checkpoint")
    saved = checkpoints.read(file)
    target = output or Path(f"{saved.config().terrain.plugin_name}.{kind.value}")
    check_writable(target)
    robot = robot_fields(Overrides.parse(overrides or ()).values())
    print(f"exporting {saved.path} and comparing it with torch …", file=sys.stderr, flush=True)
    found = export(saved, kind.value, target, robot)
    show(found, lambda: print_export(target, saved.path, found), as_json=as_json)
