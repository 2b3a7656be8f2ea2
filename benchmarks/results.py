"""Evaluations whose results are kept in ``docs/results/`` and shown in tables of the documentation.

``python -m benchmarks.results NAME`` plays one of them anew and replaces its file; then
``python -m benchmarks.tables`` rewrites the tables. ``--jobs 2`` uses two processes. ``shipped``
plays everything that ships, with the trainings in ``--runs``, and goes on where an earlier call
ended; the commands of the trainings are in ``benchmarks.shipped``.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import shipped, tables
from flipperctl import __version__, entry
from flipperctl.cli.main import main as flipperctl
from flipperctl.errors import FlipperctlError
from flipperctl.evaluation.views.card import rows_of
from flipperctl.files import write_bytes

_NOISE = "perception.noise=0.01 perception.angle_noise=0.01 episode.start_angle_noise=0.05"
_TEN = "step,stair,building_stair,ramp,uplift,gap,wave,rubble,pallet,plum"
COMMANDS: Mapping[str, str] = {
    "generalist": "flipperctl eval --checkpoint generalist --episodes 100 --seed 61157 "
    f"--baseline okada,level,random conditions=wide terrain={_TEN}",
    "paper_scenes": "flipperctl eval --checkpoint generalist --episodes 100 "
    f"--baseline okada,level,random terrain=paper_step,paper_stair {_NOISE}",
    "cells_planar": "flipperctl eval suite=generalist sim=planar --checkpoint generalist "
    "--episodes 100 --seed 61158 --baseline okada,level",
    "cells_mujoco": "flipperctl eval suite=generalist sim=mujoco --checkpoint generalist "
    "--episodes 100 --seed 61143 --baseline okada,level",
    "cells_3d": "flipperctl eval suite=generalist_3d --checkpoint generalist "
    "--controller okada,level --episodes 100 --seed 61144",
}
"""The command of each file; those whose names begin with ``cells_`` are of a suite's scenes."""
SHIPPED = "shipped"
"""Name of the results of everything that ships, with a file for each suite."""
NAMES = (*COMMANDS, SHIPPED)
"""What can be played."""


def play(name: str, output: Path, jobs: int = 1) -> None:
    """Run the command of a file and keep its results.

    ``output``: folder for the episodes of a suite, which goes on where an earlier call ended.

    Raises:
        FlipperctlError: the command failed.
    """
    words = [*shlex.split(COMMANDS[name])[1:], "--jobs", str(jobs)]
    if name.startswith(tables.CELLS):
        _run([*words, "--output", str(output / name)])
        rows = shipped.cells(output / name)
    else:
        rows = list(rows_of(json.loads(_run([*words, "--json"]))))
    _keep(name, {"command": COMMANDS[name], "version": __version__}, {"rows": rows})


def play_shipped(runs: Path, output: Path, jobs: int, numbers: shipped.Numbers) -> None:
    """Play everything that ships and keep a file of results for each suite.

    Raises:
        FlipperctlError: a command failed, or there are no trainings.
    """
    command = f"python -m benchmarks.results {SHIPPED} --fast {numbers.fast} --slow {numbers.slow}"
    for suite, found in shipped.play(_run, runs, output, jobs, numbers):
        head = {"command": command, "version": __version__, "price": found["price"]}
        rows = {name: found[name] for name in ("trainings", "overview", "scenes")}
        _keep(f"{SHIPPED}_{suite}", head, rows)


def _run(words: Sequence[str]) -> str:
    """Run a command of flipperctl and return what it printed."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        try:
            flipperctl(list(words))
        except SystemExit as ended:
            if ended.code:
                text = f"flipperctl {shlex.join(words)}: exit code {ended.code}"
                raise FlipperctlError(text) from ended
    return out.getvalue()


def _keep(name: str, head: Mapping[str, Any], rows: Mapping[str, list[dict[str, Any]]]) -> None:
    """Write a file of results with a row on each line, for readable changes."""
    tables.FOLDER.mkdir(exist_ok=True)
    parts = [json.dumps(head)[1:-1]]
    for key, each in rows.items():
        lines = ",\n".join(json.dumps(row) for row in each)
        parts.append(f'"{key}": [\n{lines}\n]')
    write_bytes(tables.FOLDER / f"{name}.json", f"{{{', '.join(parts)}}}\n".encode())


def main() -> int:
    """Play the named evaluations; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.results", description=__doc__)
    parser.add_argument("names", nargs="+", choices=NAMES, metavar="NAME", help=", ".join(NAMES))
    few = shipped.Numbers()
    for option, kind, default, text in (
        ("--jobs", int, 1, "processes"),
        ("--runs", Path, Path("runs/shipped"), f"{SHIPPED}: folder of the trainings"),
        ("--output", Path, Path("judged"), f"{SHIPPED}, {tables.CELLS}…: folder of the episodes"),
        ("--fast", int, few.fast, f"{SHIPPED}: episodes a scene of rules and learned policies"),
        ("--slow", int, few.slow, f"{SHIPPED}: episodes a scene of mpc and planner"),
    ):
        parser.add_argument(option, type=kind, default=default, help=f"{text} [{default}]")
    asked = parser.parse_args()
    for name in asked.names:
        if name == SHIPPED:
            numbers = shipped.Numbers(asked.fast, asked.slow)
            play_shipped(asked.runs, asked.output, asked.jobs, numbers)
        else:
            play(name, asked.output, asked.jobs)
    return 0


if __name__ == "__main__":
    entry.run(main)
