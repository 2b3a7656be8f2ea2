"""Evaluations whose results are kept in ``docs/results/`` and shown in tables of the documentation.

``python -m benchmarks.results NAME`` plays one of them anew and replaces its file; then
``python -m benchmarks.tables`` rewrites the tables. ``--jobs 2`` uses two processes.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import shlex
from collections.abc import Mapping
from pathlib import Path

from flipperctl import __version__, entry
from flipperctl.cli.main import main as flipperctl
from flipperctl.errors import FlipperctlError
from flipperctl.evaluation.result_rows import rows_of
from flipperctl.files import write_bytes

FOLDER = Path(__file__).parents[1] / "docs" / "results"
"""Folder of the kept results."""
_NOISE = "perception.noise=0.01 perception.angle_noise=0.01 episode.start_angle_noise=0.05"
_TEN = "step,stair,building_stair,ramp,uplift,gap,wave,rubble,pallet,plum"
COMMANDS: Mapping[str, str] = {
    "generalist": "flipperctl eval --checkpoint generalist --episodes 100 --seed 60241 "
    f"--baseline okada,level,random conditions=trained terrain={_TEN}",
    "paper_scenes": "flipperctl eval --checkpoint generalist --episodes 100 "
    f"--baseline okada,level,random terrain=paper_step,paper_stair {_NOISE}",
}
"""The command of each file."""


def play(name: str, jobs: int = 1) -> None:
    """Run the command of a file and keep its results.

    Raises:
        FlipperctlError: the command failed.
    """
    out = io.StringIO()
    words = [*shlex.split(COMMANDS[name])[1:], "--jobs", str(jobs), "--json"]
    with contextlib.redirect_stdout(out):
        try:
            flipperctl(words)
        except SystemExit as ended:
            if ended.code:
                raise FlipperctlError(f"{COMMANDS[name]}: exit code {ended.code}") from ended
    FOLDER.mkdir(exist_ok=True)
    rows = [row.to_dict() for row in rows_of(json.loads(out.getvalue()))]
    lines = ",\n".join(json.dumps(row) for row in rows)
    head = json.dumps({"command": COMMANDS[name], "version": __version__})
    text = f'{head[:-1]}, "rows": [\n{lines}\n]}}\n'  # a row on each line, for readable changes
    write_bytes(FOLDER / f"{name}.json", text.encode())


def main() -> int:
    """Play the named evaluations; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.results", description=__doc__)
    parser.add_argument(
        "names", nargs="+", choices=COMMANDS, metavar="NAME", help=", ".join(COMMANDS)
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes [1]")
    asked = parser.parse_args()
    for name in asked.names:
        play(name, asked.jobs)
    return 0


if __name__ == "__main__":
    entry.run(main)
