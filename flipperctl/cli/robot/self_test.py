"""``flipperctl robot self-test``."""

from __future__ import annotations

from typing import Annotated

import typer

from flipperctl.cli import options

HELP = """Find wrong signs on a robot: move each part when told, and see how it was measured.

MESSAGES is a file of JSON lines with what the robot's devices measure, or - for a pipe. Each sign
that is wrong is named with what to set. Exit code 0: every motion was measured with the right sign.

The robot's own computer needs only numpy and onnxruntime for the same test:
python -m flipperctl.runtime --self-test MESSAGES.

[bold]Examples[/]

  flipperctl robot self-test messages.jsonl --signs rep103

  my_driver | flipperctl robot self-test - --signs rep103
"""


def run(
    messages: Annotated[str, typer.Argument(help="Lines of JSON, or - for a pipe.")],
    signs: Annotated[
        options.Convention, typer.Option(metavar="NAME", help="Signs of the messages.")
    ] = options.Convention.flipperctl,
    plugins: options.PluginPaths = None,
) -> int:
    """See HELP."""
    from flipperctl.runtime import RobotSetup, self_test
    from flipperctl.runtime.messages import CONVENTIONS

    setup = RobotSetup(signs=CONVENTIONS[signs.value])
    return self_test.run(*self_test.opened(messages), setup)
