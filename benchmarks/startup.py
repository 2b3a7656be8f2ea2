"""Wall-clock time that a user waits for short commands, each in a fresh process."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import partial
from typing import Any

import typer.main

from benchmarks.settings import Benchmark, milliseconds, quantity, ratio
from flipperctl.cli.main import app
from flipperctl.commands.speed import measure_in_turn, output

ABOUT = "wall-clock of commands in separate processes, in turn, compared with Python's own start"
PYTHON = "python -c pass"

Command = tuple[str, ...]
"""Arguments of ``flipperctl`` on the command line."""


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure the time of each command [ms], and its ratio to the start of Python itself."""
    s = bench.settings
    processes = {PYTHON: [sys.executable, "-c", "pass"]}
    for command in short_commands()[: s.commands]:
        name = " ".join(("flipperctl", *command))
        processes[name] = [sys.executable, "-m", "flipperctl", *command]
    clocks = {
        name: milliseconds(partial(output, process, f"startup: {name}"))
        for name, process in processes.items()
    }
    for index, clock in enumerate(clocks.values()):
        bench.report_progress("warm-up, to cache every file", 0.1 * index / len(clocks))
        clock()
    found = measure_in_turn(
        clocks,
        s.repeats,
        lambda done: bench.report_progress("processes in turn", 0.1 + 0.9 * done),
    )
    return {
        "about": ABOUT,
        "quantities": {name: quantity(values, "ms") for name, values in found.items()},
        "ratios": {
            f"{name} / {PYTHON}": ratio(values, found[PYTHON])
            for name, values in found.items()
            if name != PYTHON
        },
    }


def short_commands() -> list[Command]:
    """Return every subcommand's help, in the order of help, and two short views of ``inspect``."""
    root = typer.main.get_command(app)
    helps = [(*path, "--help") for path in _paths(root, ())]
    return [*helps, ("inspect", "plugins"), ("inspect", "terrain", "stair", "--json")]


def _paths(command: Any, path: Command) -> Iterator[Command]:
    yield path
    for name, inner in getattr(command, "commands", {}).items():
        yield from _paths(inner, (*path, name))
