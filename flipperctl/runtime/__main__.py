"""``python -m flipperctl.runtime FILE``: print the interface of an exported policy."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from flipperctl import entry
from flipperctl.errors import RequestError

if TYPE_CHECKING:
    from flipperctl.runtime.interface import Interface

HELP = """Usage: python -m flipperctl.runtime FILE
       python -m flipperctl.runtime --self-test MESSAGES [--signs rep103]
       python -m flipperctl.runtime --shadow FILE MESSAGES [--signs rep103]

Check an exported policy, an .onnx file, and print its interface: the observation with units,
frames and limits, the actions, the decision period, the robot and the training.
It needs only numpy and onnxruntime.

--self-test finds wrong signs on the robot: it says which part to move, reads what the devices
measure from a file of JSON lines, or from a pipe with the name -, and names each sign that is
wrong. --shadow prints what a policy would do on such messages, a line of JSON for each decision and
each change of state, while nothing moves by it. --signs is the convention of the messages,
flipperctl (default) or rep103.

Examples

  python -m flipperctl.runtime stair.onnx

  python -m flipperctl.runtime --self-test messages.jsonl --signs rep103

  python -m flipperctl.runtime --shadow stair.onnx messages.jsonl --signs rep103

  python -m flipperctl.runtime --help"""


def describe(interface: Interface) -> str:
    """Return a table of the observation, the actions and the robot."""
    import numpy as np

    rows = [
        (str(index), q.name, q.unit, q.frame, f"±{limit:.3f}", q.meaning)
        for index, (q, limit) in enumerate(
            zip(interface.observation, interface.limits, strict=True)
        )
    ]
    rows.insert(0, ("", "name", "unit", "frame", "within", "meaning"))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["observation"]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        lines.append("  " + "  ".join(cells).rstrip())
    lines.append(f"actions: turns of the {' and the '.join(interface.joints)} flippers [°]")
    for index, turns in enumerate(np.degrees(interface.actions)):
        lines.append(f"  {index}  {' '.join(f'{turn:+6.1f}' for turn in turns)}")
    lines.append(f"decision period: {interface.decision_period:g} s")
    lines.append("robot, in SI units")
    lines += [f"  {name}: {value:g}" for name, value in interface.robot.items()]
    lines.append(f"trained on {interface.terrain} by flipperctl {interface.package_version}")
    return "\n".join(lines)


def main() -> None:
    """Print the interface of the file named on the command line."""
    entry.stop_at_once()
    entry.run(lambda: _main(sys.argv[1:]))


def _main(words: list[str]) -> int:
    if {"-h", "--help"} & set(words):
        print(HELP)
        return 0
    if {"--self-test", "--shadow"} & set(words):
        return _on_messages(words)
    if len(words) != 1 or words[0].startswith("-"):
        raise RequestError(
            f"expected one exported policy, as in python -m flipperctl.runtime stair.onnx; "
            f"got {shlex.join(words) or 'nothing'}; see --help"
        )
    from flipperctl.runtime.policy import OnnxPolicy

    print(describe(OnnxPolicy(words[0]).interface))
    return 0


def _on_messages(words: list[str]) -> int:
    """Run the self-test, or a policy in shadow mode, on a file of messages."""
    from flipperctl.runtime import self_test, shadow
    from flipperctl.runtime.robot_setup import RobotSetup
    from flipperctl.runtime.signs import CONVENTIONS

    rest, name = list(words), "flipperctl"
    if "--signs" in rest[:-1]:
        at = rest.index("--signs")
        name = rest[at + 1]
        del rest[at : at + 2]
    policy: Path | None = None
    match rest:
        case ["--self-test", file]:
            pass
        case ["--shadow", model, file]:
            policy = Path(model)
        case _:
            raise RequestError(
                "expected python -m flipperctl.runtime --self-test MESSAGES [--signs NAME] or "
                f"--shadow FILE MESSAGES [--signs NAME]; got {shlex.join(words)}; see --help"
            )
    if name not in CONVENTIONS:
        known = ", ".join(CONVENTIONS)
        raise RequestError(f"there is no convention {name!r}; {known} is allowed")
    setup = RobotSetup(signs=CONVENTIONS[name])

    def run(lines: Iterable[str], where: str) -> int:
        if policy is None:
            return self_test.run(lines, where, setup)
        return shadow.run(policy, self_test.read_lines(lines, where), setup)

    if file == "-":
        return run(sys.stdin, "the input")
    try:
        with Path(file).open(encoding="utf-8") as lines:
            return run(lines, file)
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise RequestError(f"{file} cannot be read: {error}") from error


if __name__ == "__main__":
    main()
