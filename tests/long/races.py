"""Pairs of processes that race for one run: one wins, the other is refused, the run is complete.

``python -m tests.long.races --count 100 --seed 1`` starts two fresh runs, two resumed runs, or one
of each in one run directory, and prints a table; it fails on any violation.
"""

import argparse
import os
import random
import shutil
import signal
import sys
import time
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.long.forked import Command, Tally, differences, preload, progress, report, start
from tests.long.kills import Reference, reference

KINDS = ("fresh + fresh", "resume + resume", "fresh + resume")
_RESUME = ["train", "--resume", "run"]
_REFUSALS = ("is being trained by", "already holds a run", "no such run", "holds neither")
_LATE = "nothing left to do"


def interrupted_run(model: Reference, folder: Path) -> Path:
    """Return the directory of a run that was interrupted, to resume from."""
    folder.mkdir()
    command = start(model.arguments, folder, folder / "log")
    metrics = folder / "run" / "metrics.csv"
    while not metrics.exists() or metrics.read_text().count("\n") < 3:
        if command.ended():
            raise SystemExit(f"it was to be interrupted: {command.text}")
        time.sleep(0.001)
    os.kill(command.pid, signal.SIGTERM)
    if not command.wait() or command.code != 130:
        raise SystemExit(f"it was to be interrupted: {command.text}")
    return folder / "run"


def race(
    kind: str, model: Reference, stopped: Path, folder: Path, rng: random.Random
) -> Tally | None:
    """Let two commands race; return None if the second started after the first had finished."""
    folder.mkdir()
    if kind == "resume + resume":
        shutil.copytree(stopped, folder / "run")
    commands = {"fresh": model.arguments, "resume": _RESUME}
    pair = [commands[word] for word in kind.split(" + ")]
    if rng.random() < 0.5:
        pair.reverse()
    delay = rng.choice([0.0, 0.0, rng.uniform(0.0, 0.6)]) * model.whole
    first = start(pair[0], folder, folder / "log0")
    while first.age < delay:
        time.sleep(0.001)
    second = start(pair[1], folder, folder / "log1")
    tally = Tally(count=1)
    for command in (first, second):
        tally.hangs += not command.wait()
        tally.hangs += not command.workers_ended()
    if _LATE in first.text + second.text:
        return None
    _check_pair(tally, [first, second])
    wrong = differences(folder / "run", model.found)
    tally.changes += bool(wrong)
    if tally.violations:
        print(f"{kind}, {delay:.3f} s: {wrong}\n{first.text}\n{second.text}", file=sys.stderr)
    return tally


def _check_pair(tally: Tally, pair: list[Command]) -> None:
    """Check that one command won and the other was refused in one line."""
    codes = sorted(str(command.code) for command in pair)
    for command in pair:
        tally.check(command, 0, 2)
        refused = [line for line in command.text.splitlines() if line.startswith("error: ")]
        right = len(refused) == 1 and any(word in refused[0] for word in _REFUSALS)
        tally.wrong_codes += command.code == 2 and not right
    tally.wrong_codes += codes != ["0", "2"]


def run(count: int, seed: int, folder: Path, fast: float) -> int:
    """Let ``count`` pairs race, a fraction ``fast`` with workers; return the exit code."""
    begun = time.monotonic()
    rng = random.Random(seed)
    preload()
    names = ["exact"] * (fast < 1) + ["fast"] * (fast > 0)
    modes = {mode: reference(mode, folder / mode) for mode in names}
    stopped = {mode: interrupted_run(modes[mode], folder / f"stopped-{mode}") for mode in modes}
    tallies: dict[str, Tally] = defaultdict(Tally)
    done = 0
    for index in range(5 * count):
        if done == count:
            return report(tallies, time.monotonic() - begun)
        kind = KINDS[done % len(KINDS)]
        mode = "fast" if rng.random() < fast else "exact"
        case = folder / f"case{index}"
        one = race(kind, modes[mode], stopped[mode], case, rng)
        shutil.rmtree(case)
        if one is not None:
            done += 1
            tallies[f"{kind}, {mode}"].add(one)
            progress(tallies, count)
    print(f"only {done} of {count} pairs met", file=sys.stderr)
    return 1


def main() -> None:
    """Parse the command line and run the races."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fast", type=float, default=0.2, help="fraction with worker processes")
    options = parser.parse_args()
    with TemporaryDirectory(prefix="races-", ignore_cleanup_errors=True) as folder:
        sys.exit(run(options.count, options.seed, Path(folder), options.fast))


if __name__ == "__main__":
    main()
