"""Wall-clock of short commands, each in a fresh process: what a user waits for."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from flipperctl.bench.process import output
from flipperctl.bench.settings import Bench
from flipperctl.bench.spread import in_turn, quantity, ratio

ABOUT = "wall-clock of commands as processes of their own, in turn, beside Python's own start"
PYTHON = "python -c pass"

Command = tuple[str, ...]
"""What follows ``flipperctl`` on the command line."""


def measure(bench: Bench, commands: Sequence[Command]) -> dict[str, Any]:
    """Milliseconds of each command, and how many times Python's own start that is.

    Raises:
        FlipperctlError: a command failed.
    """
    s = bench.settings
    processes = {PYTHON: [sys.executable, "-c", "pass"]}
    for command in commands[: s.commands]:
        processes[" ".join(("flipperctl", *command))] = [
            sys.executable,
            "-m",
            "flipperctl",
            *command,
        ]
    clocks = {name: _clock(name, process) for name, process in processes.items()}
    for index, clock in enumerate(clocks.values()):
        bench.tell("once, so that every file is in the cache", 0.1 * index / len(clocks))
        clock()
    found = in_turn(
        clocks, s.repeats, lambda share: bench.tell("processes in turn", 0.1 + 0.9 * share)
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


def _clock(name: str, process: list[str]) -> Callable[[], float]:
    def clock() -> float:
        begun = time.perf_counter()
        output(process, f"startup: {name}")
        return 1e3 * (time.perf_counter() - begun)

    return clock
