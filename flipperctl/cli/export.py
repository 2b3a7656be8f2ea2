"""``flipperctl export``."""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli.options import AsJson, PluginPaths

HELP = """Write a policy for the robot: [bold]onnx[/], or [bold]pt2[/] (torch.export).

Before the file is saved under its name, it is compared with torch on at least 1,000 observations
of real rollouts; a mismatch is an error.

[bold]Examples[/]

  flipperctl export onnx --checkpoint runs/stair/2026-01-31_12-00-00 --output stair.onnx

  flipperctl export pt2 --checkpoint best.safetensors
"""


class Kind(StrEnum):
    """File formats of an exported policy."""

    onnx = "onnx"
    pt2 = "pt2"


def add_to(app: typer.Typer) -> None:
    """Register the subcommand."""
    app.command("export", help=HELP)(export)


def export(
    kind: Annotated[Kind, typer.Argument(help="The format.")],
    checkpoint: Annotated[
        Path, typer.Option(metavar="RUN_OR_FILE", help="A run directory or a checkpoint.")
    ],
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="[<terrain>.<format>]", show_default=False)
    ] = None,
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl import checkpoint as checkpoints
    from flipperctl import plugins as loader
    from flipperctl.cli.policy_file import find_policy
    from flipperctl.export.policy import export as run
    from flipperctl.files import check_writable

    loader.load(plugins or ())
    saved = checkpoints.read(find_policy(checkpoint))
    target = output or Path(f"{saved.config().terrain.plugin_name}.{kind.value}")
    check_writable(target)
    print(f"exporting {saved.path} and comparing it with torch …", file=sys.stderr, flush=True)
    found = run(saved, kind.value, target)
    if as_json:
        print(json.dumps(found, indent=2))
        return
    print(
        f"{target}: {found['bytes']} bytes, from {saved.path}\n"
        f"compared with torch on {found['observations']} observations of rollouts: "
        f"Q-values of up to {found['largest_q_value']:.2g} differ by at most "
        f"{found['largest_difference']:.2g} (allowed {found['allowed_difference']:.2g}), "
        f"the chosen action agrees on {found['action_agreement']:.2%}"
    )
