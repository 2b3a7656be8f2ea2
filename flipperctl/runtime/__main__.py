"""``python -m flipperctl.runtime FILE``: print the interface of an exported policy."""

from __future__ import annotations

import sys

import numpy as np

from flipperctl.errors import FlipperctlError
from flipperctl.runtime.interface import Interface
from flipperctl.runtime.policy import OnnxPolicy


def describe(interface: Interface) -> str:
    """Return a table of the observation, the actions and the robot."""
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
    lines.append("actions: turns of the front and the rear flippers [°]")
    for index, (front, rear) in enumerate(np.degrees(interface.actions)):
        lines.append(f"  {index}  {front:+6.1f} {rear:+6.1f}")
    lines.append(f"decision period: {interface.decision_period:g} s")
    lines.append("robot, in SI units")
    lines += [f"  {name}: {value:g}" for name, value in interface.robot.items()]
    lines.append(f"trained on {interface.terrain} by flipperctl {interface.package_version}")
    return "\n".join(lines)


def main() -> None:
    """Print the interface of the file named on the command line."""
    if len(sys.argv) != 2:
        print("error: usage: python -m flipperctl.runtime FILE", file=sys.stderr)
        sys.exit(2)
    try:
        print(describe(OnnxPolicy(sys.argv[1]).interface))
    except FlipperctlError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(error.exit_code)


if __name__ == "__main__":
    main()
