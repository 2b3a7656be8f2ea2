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
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> int:
    """See HELP."""
    from dataclasses import asdict

    from flipperctl.runtime.messages import CONVENTIONS, RobotSetup
    from flipperctl.runtime.recordings import opened, self_test
    from flipperctl.terminal.streams import show

    setup = RobotSetup(signs=CONVENTIONS[signs.value])
    test = self_test(*opened(messages), setup)  # it prints what to do meanwhile
    document = {"passed": test.passed, "verdicts": [asdict(one) for one in test.verdicts]}
    show(document, lambda: None, as_json=as_json)
    return 0 if test.passed else 1
