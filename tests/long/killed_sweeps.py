"""Sweeps stopped at random times by SIGINT, SIGTERM or SIGKILL, and typed again until they end.

``python -m tests.long.killed_sweeps --count 40 --seed 1`` stops real sweeps, a fraction
``--joblib`` of them with worker processes, types the same words again and compares each run with
that of a sweep that was never stopped, bit for bit. It prints a table and fails on any violation.
"""

import argparse
import csv
import random
import shutil
import signal
import sys
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.long.forked import QUICK, Command, Tally, differences, preload, progress, report, start
from tests.long.forked import result as run_result

SHORT = ["train.decisions=150", "train.validate_every=75", "train.checkpoint_every=40"]
SWEEP = ["train", "-m", *{o.partition("=")[0]: o for o in [*QUICK, *SHORT]}.values()]
SWEEP += ["train.mode=exact", "seed=1,2,3", "hydra.sweep.dir=sweep"]
LAUNCHERS = {
    "basic": [],
    "joblib": ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"],
}
STOPS = {
    "SIGINT": (signal.SIGINT, False),
    "SIGINT to all": (signal.SIGINT, True),  # as Ctrl-C in a terminal
    "SIGTERM": (signal.SIGTERM, False),
    "SIGKILL": (signal.SIGKILL, False),
}
"""The signal, and whether the worker processes get it too."""
_MOST = 3
"""Largest number of stops of one sweep."""


@dataclass(frozen=True)
class Reference:
    """A sweep that was not stopped."""

    arguments: list[str]
    runs: dict[str, dict[str, Any]]
    """Result of each run, by the name of its folder."""
    seconds: float


def reference(launcher: str, folder: Path) -> Reference:
    """Sweep to the end and return the runs."""
    arguments = [*SWEEP, *LAUNCHERS[launcher]]
    folder.mkdir()
    command = start(arguments, folder, folder / "log")
    command.wait()
    if command.code != 0:
        raise SystemExit(f"the reference failed: {command.text}")
    runs = {path.parent.name: path.parent for path in folder.glob("sweep/*/config.yaml")}
    return Reference(arguments, {n: run_result(run) for n, run in runs.items()}, command.age)


def case(model: Reference, stop: str, folder: Path, rng: random.Random) -> Tally:
    """Stop a sweep up to three times, type it again until it ends, and compare its runs."""
    tally = Tally(count=1)
    folder.mkdir()
    for _ in range(rng.randint(1, _MOST)):
        command = start(model.arguments, folder, folder / "log")
        _interrupt(command, stop, rng.uniform(0.0, model.seconds), tally)
        if command.code == 0:
            break
    last = start(model.arguments, folder, folder / "log")
    tally.hangs += not last.wait()
    tally.check(last, 0)
    last.kill_group()
    wrong = [
        f"{name}: {part}"
        for name, found in model.runs.items()
        for part in differences(folder / "sweep" / name, found)
    ]
    with (folder / "sweep" / "sweep.csv").open(newline="") as file:
        states = [row["state"] for row in csv.DictReader(file)]
    if states != ["finished"] * len(model.runs):
        wrong.append(f"sweep.csv: {states}")
    tally.changes += bool(wrong)
    if tally.violations:
        print(f"{folder}, {stop}: {wrong}; {(folder / 'log').read_text()}", file=sys.stderr)
    else:
        shutil.rmtree(folder)
    return tally


def _interrupt(command: Command, stop: str, at: float, tally: Tally) -> None:
    """Send the signal at a time [s] and wait for the end of all processes."""
    number, everyone = STOPS[stop]
    while command.age < at and not command.ended():
        time.sleep(0.001)
    command.send(number, everyone=everyone)
    tally.hangs += not command.wait()
    # Before the command has its own handler, SIGTERM ends it as it ends any process.
    expected = (-number, 0) if number == signal.SIGKILL else (130, -signal.SIGTERM, 0)
    tally.check(command, *expected)
    if command.code == -signal.SIGKILL:
        tally.hangs += not command.workers_ended()
    else:  # a forked command leaves without joblib's own end of its processes
        command.kill_group()


def run(count: int, seed: int, folder: Path, joblib: float, stops: list[str]) -> int:
    """Stop ``count`` sweeps, a fraction ``joblib`` of them with workers; return the exit code."""
    begun = time.monotonic()
    rng = random.Random(seed)
    preload()
    names = ["basic"] * (joblib < 1) + ["joblib"] * (joblib > 0)
    models = {name: reference(name, folder / name) for name in names}
    tallies: dict[str, Tally] = defaultdict(Tally)
    for index in range(count):
        name = "joblib" if rng.random() < joblib else "basic"
        stop = stops[index % len(stops)]
        tallies[f"{name}, {stop}"].add(case(models[name], stop, folder / f"case{index}", rng))
        progress(tallies, count)
    return report(tallies, time.monotonic() - begun)


def main() -> None:
    """Parse the command line and run the cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--joblib", type=float, default=0.2, help="fraction with worker processes")
    parser.add_argument("--stops", nargs="+", choices=STOPS, default=list(STOPS))
    options = parser.parse_args()
    with TemporaryDirectory(prefix="kills-", ignore_cleanup_errors=True) as folder:
        sys.exit(run(options.count, options.seed, Path(folder), options.joblib, options.stops))


if __name__ == "__main__":
    main()
