"""``python -m flipperctl.runtime FILE``: print the interface of an exported policy."""

from __future__ import annotations

import math
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from flipperctl.errors import RequestError
from flipperctl.process import entry

if TYPE_CHECKING:
    from flipperctl.runtime.interface import Interface

HELP = """Usage: python -m flipperctl.runtime FILE
       python -m flipperctl.runtime --self-test MESSAGES [--signs rep103 | devices=FILE]
       python -m flipperctl.runtime --shadow FILE MESSAGES [--signs rep103 | devices=FILE]

Check an exported policy, an .onnx file, and print its interface: the observation with units,
frames and limits, input and outputs, the actions, the decision period, the rule of the targets, the
risk, the escape and the map, the robot and the training.
It needs only numpy and onnxruntime.

--self-test finds wrong signs on the robot: it says which part to move, reads what the devices
measure from a file of JSON lines, or from a pipe with the name -, and names each sign that is
wrong. --shadow prints what a policy would do on such messages, a line of JSON for each decision and
each change of state, while nothing moves by it. --signs is the convention of the messages,
flipperctl (default) or rep103. devices=FILE has the robot's joints, signs, units, widths, mount and
limits, YAML (needs ruamel.yaml) or JSON; messages then have the numbers of the robot's topics.
Without either, --shadow takes the devices that FILE holds.

Examples

  python -m flipperctl.runtime stair.onnx

  python -m flipperctl.runtime --self-test messages.jsonl --signs rep103

  python -m flipperctl.runtime --shadow stair.onnx messages.jsonl --signs rep103

  python -m flipperctl.runtime --help"""


def describe(interface: Interface) -> str:
    """Return the observation as a table, then input and outputs, actions, targets and robot."""
    import numpy as np

    from flipperctl.core.risk import LAGS
    from flipperctl.runtime.interface import INPUT, RECURRENCE, RISK

    # The observation, number by number
    rows = [("", "name", "unit", "frame", "within", "meaning")]
    for index, (q, limit) in enumerate(zip(interface.observation, interface.limits, strict=True)):
        rows.append((str(index), q.name, q.unit, q.frame, f"±{limit:.3f}", q.meaning))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["observation"]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        lines.append("  " + "  ".join(cells).rstrip())

    # Input and outputs of the network
    frame, sign, escape = "one observation", interface.risk, interface.escape
    if interface.frames > 1:
        frame = (
            f"the last {interface.frames} observations of {interface.size} numbers, oldest first; "
            "at the start of an episode the first one also fills the frames before it"
        )
    lines.append(f"input: {INPUT}, float32 [batch, {interface.inputs}], {frame}")
    lines.append(f"output: {interface.output}, float32 [batch, {len(interface.actions)}]")
    if sign is not None:
        lines.append(f"output: {RISK}, float32 [batch, 1], of the input alone")
        lines.append(
            f"output: {RECURRENCE}, float32 [batch, {len(LAGS)}], what resembling the observations "
            f"{', '.join(map(str, LAGS))} decisions before adds to its log-odds"
        )
    each = " by a rate of 1 of each" if interface.kind == "rates" else ""
    lines.append(f"actions: turns of the front and the rear flippers{each} [°]")
    for index, turns in enumerate(np.degrees(interface.actions)):
        lines.append(f"  {index}  {' '.join(f'{turn:+6.1f}' for turn in turns)}")
    lines.append(f"decision period: {interface.decision_period:g} s")
    rule = interface.targets
    lines.append(
        f"targets: last target, held within {math.degrees(rule.window):.1f}° of the measured "
        f"angle, + turn, within ±{math.degrees(rule.limit):.1f}°"
    )
    if sign is not None:
        lines.append(
            f"risk: probability of a failure within the next {sign.horizon} decisions; "
            f"{sign.threshold:.3g} or more is a warning"
        )
    if escape is not None:
        lines.append(
            f"escape: from a warning on, {escape.decisions} decisions draw their actions from "
            f"softmax(q_values / {escape.temperature:g})"
        )
    if (known := interface.map_quality) is not None:
        motion = "corrected" if known.deskew else "not corrected"
        lines.append(
            f"map: ground within {known.half_width:g} m to each side, cells {known.cell:g} m long "
            f"and {known.lane:g} m wide of up to {known.keep} points, columns of {known.fewest} or "
            f"more, points with a noise of {known.noise:g} m, {motion} for the motion in a scan"
        )
    lines.append("robot, in SI units")
    lines += [f"  {name}: {value:g}" for name, value in interface.robot.items()]
    lines.append(f"trained on {interface.terrain} by flipperctl {interface.package_version}")
    return "\n".join(lines)


def main() -> None:
    """Print the interface of the file named on the command line."""
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
    from flipperctl.runtime.devices import SECTION, read_devices
    from flipperctl.runtime.messages import CONVENTIONS
    from flipperctl.runtime.policy import OnnxPolicy
    from flipperctl.runtime.recordings import Shadow, opened, read_lines, self_test, setup_by

    # What remains besides the convention or the devices must be one of two forms.
    files = [word.partition("=")[2] for word in words if word.startswith(f"{SECTION}=")]
    rest, signs = [word for word in words if not word.startswith(f"{SECTION}=")], None
    if "--signs" in rest[:-1]:
        at = rest.index("--signs")
        signs = rest[at + 1]
        del rest[at : at + 2]
    match rest:
        case ["--self-test", _] | ["--shadow", _, _] if len(files) + (signs is not None) < 2:
            pass
        case _:
            raise RequestError(
                "expected python -m flipperctl.runtime --self-test MESSAGES [--signs NAME] or "
                f"--shadow FILE MESSAGES [--signs NAME], or {SECTION}=FILE in place of --signs; "
                f"got {shlex.join(words)}; see --help"
            )
    if signs is not None and signs not in CONVENTIONS:
        known = ", ".join(CONVENTIONS)
        raise RequestError(f"there is no convention {signs!r}; {known} is allowed")

    # The devices of the word, or of the policy that is tried
    devices = read_devices(Path(files[0])) if files else None
    if devices is None and signs is None and rest[0] == "--shadow":
        devices = OnnxPolicy(rest[1]).interface.devices
    setup, (lines, where) = setup_by(devices, signs or "flipperctl"), opened(rest[-1])
    if rest[0] == "--self-test":
        return 0 if self_test(lines, where, setup, devices).passed else 1
    limits = None if devices is None else devices.limits
    shadow = Shadow(Path(rest[1]), setup, lambda line: print(line, flush=True), limits)
    for now, messages in read_lines(lines, where, devices):
        shadow.take(now, messages)
    return 0


if __name__ == "__main__":
    main()
