"""``flipperctl card``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options

HELP = """Write a policy's card: what it is, how it was trained, what it reached and where it fails.

The card is Markdown with the front matter of the Hugging Face Hub, whose model-index has the
results. RESULTS are folders of [bold]eval --output[/] with this policy; their baselines stand
beside it. Each command in the card gives the same hash of conditions, which is checked.

[bold]Examples[/]

  flipperctl eval generalist --baseline okada,level terrain=stair --output evaluated

  flipperctl card generalist evaluated --output card.md
"""


def run(
    policy: Annotated[
        Path, typer.Argument(metavar="RUN_OR_POLICY", help="A run, a checkpoint or a shipped one.")
    ],
    results: Annotated[
        list[Path] | None, typer.Argument(metavar="RESULTS", help="Folders of eval --output.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The card, else standard output.")
    ] = None,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.cli.card_commands import evaluation_commands
    from flipperctl.errors import RequestError
    from flipperctl.evaluation.views.card import CARD, card_facts, card_text
    from flipperctl.files import check_output, write_bytes
    from flipperctl.runs.inherited import find_policy
    from flipperctl.terminal.streams import print_note

    file = find_policy(policy, print_note)
    if file.suffix == ".onnx":
        raise RequestError(f"{file} is exported; give its run or checkpoint")
    if output is not None:
        check_output(output, CARD)
    folders = results or []
    card_facts(policy, file, folders)  # raises for wrong results, before anything is composed
    commands = evaluation_commands(policy, file, folders)
    text = card_text(card_facts(policy, file, folders, commands))
    if output is None:
        print(text, end="")
    else:
        write_bytes(output, text.encode())
        print_note(f"wrote {output}")
