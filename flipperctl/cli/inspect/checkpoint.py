"""``flipperctl inspect checkpoint``."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import RequestError

HELP = """Describe a checkpoint. Nothing in the file is executed, and no plugin is needed.

The SHA-256 of the content covers configuration, results, state and weights: it is equal for equal
runs, whatever versions of the packages wrote them.

[bold]Examples[/]

  flipperctl inspect checkpoint runs/stair/2026-01-31_12-00-00

  flipperctl inspect checkpoint best.safetensors --json
"""


def run(
    path: Annotated[Path, typer.Argument(metavar="RUN_OR_FILE", help="A run or a checkpoint.")],
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl import checkpoint
    from flipperctl.checkpoint.contents import contents
    from flipperctl.terminal.checkpoint import print_checkpoint
    from flipperctl.terminal.streams import show

    file = checkpoint.find(path)
    if file.suffix == ".onnx":
        raise RequestError(
            f"{file} is an exported file, not a checkpoint; "
            f"python -m flipperctl.runtime {shlex.quote(str(file))} prints its interface"
        )
    saved = checkpoint.read(file)
    found = contents(saved)
    show(found, lambda: print_checkpoint(found, saved), as_json=as_json)
