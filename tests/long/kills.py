"""SIGKILL at random times: each killed run is resumed and must equal a run that was not killed.

``python -m tests.long.kills --count 200 --early 50 --seed 1`` kills real trainings, ``--early`` of
them before their first checkpoint, and prints a table; it fails on any violation.
"""

import argparse
import random
import shutil
import sys
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.long.forked import (
    QUICK,
    Command,
    Tally,
    differences,
    preload,
    progress,
    report,
    result,
    start,
)

LAST = Path("checkpoints/last.safetensors")
_AGAIN = 0.3
"""Fraction of the resumed runs that are killed again, at most twice."""


@dataclass(frozen=True)
class Reference:
    """A run that was not killed."""

    arguments: list[str]
    found: dict[str, Any]
    begun: float
    """Time from the start until config.yaml existed [s]."""
    first: float
    """Time from the start until the first checkpoint existed [s]."""
    whole: float
    """Time from the start until the end [s]."""


def reference(mode: str, folder: Path) -> Reference:
    """Train to the end and return the run with its times."""
    arguments = ["train", *QUICK, f"train.mode={mode}", "hydra.run.dir=run"]
    folder.mkdir()
    command = start(arguments, folder, folder / "log")
    begun = first = 0.0
    while not command.ended():
        if not begun and (folder / "run" / "config.yaml").exists():
            begun = command.age
        if not first and (folder / "run" / LAST).exists():
            first = command.age
        time.sleep(0.001)
    whole = command.age
    if command.code != 0:
        raise SystemExit(f"the reference failed: {command.text}")
    return Reference(arguments, result(folder / "run"), begun, first, whole)


class Case:
    """A run that is killed once or more often and then resumed to its end."""

    def __init__(self, model: Reference, folder: Path, rng: random.Random) -> None:
        self.model, self.folder, self.rng = model, folder, rng
        self.tally = Tally(count=1)
        folder.mkdir()

    def kill(self, earliest: float, latest: float) -> str | None:
        """Kill the run at a random time [s]; return its state then, or None if it had ended."""
        command = self._start(self.model.arguments)
        if not self._killed(command, self.rng.uniform(earliest, latest)):
            return None
        run = self.folder / "run"
        if (run / LAST).exists():
            return "after the first checkpoint"
        return "before the first checkpoint" if self._begun() else "before config.yaml"

    def finish(self) -> Tally:
        """Resume the run, perhaps kill it again, and compare it with the reference."""
        resume = ["train", "--resume", "run"]
        for _ in range(2):
            if self._begun() and self.rng.random() < _AGAIN:
                self._killed(self._start(resume), self.rng.uniform(0.0, self.model.whole))
        if not self._begun():  # there is no run yet: resuming fails, and it is started again
            self._end(self._start(resume), 2)
            self._end(self._start(self.model.arguments), 0)
        else:
            self._end(self._start(resume), 0)
        wrong = differences(self.folder / "run", self.model.found)
        self.tally.changes += bool(wrong)
        if self.tally.violations:
            print(f"{self.folder}: {wrong}; {(self.folder / 'log').read_text()}", file=sys.stderr)
        else:
            shutil.rmtree(self.folder)
        return self.tally

    def _begun(self) -> bool:
        return any((self.folder / "run" / name).exists() for name in ("config.yaml", LAST))

    def _start(self, arguments: list[str]) -> Command:
        return start(arguments, self.folder, self.folder / "log")

    def _killed(self, command: Command, at: float) -> bool:
        while command.age < at and not command.ended():
            time.sleep(0.001)
        killed = command.kill()
        self.tally.hangs += not command.workers_ended()
        return killed

    def _end(self, command: Command, expected: int) -> None:
        self.tally.hangs += not command.wait()
        self.tally.check(command, expected)
        self.tally.hangs += not command.workers_ended()


def run(count: int, early: int, seed: int, folder: Path, fast: float) -> int:
    """Kill ``count`` runs, ``early`` of them before their first checkpoint; return the exit code.

    ``fast``: fraction of trainings with worker processes.
    """
    begun = time.monotonic()
    rng = random.Random(seed)
    preload()
    names = ["exact"] * (fast < 1) + ["fast"] * (fast > 0)
    modes = {mode: reference(mode, folder / mode) for mode in names}
    tallies: dict[str, Tally] = defaultdict(Tally)
    left = {"early": early, "later": count - early}
    pace = 1.0  # time that a case takes for each second of the reference
    for index in range(20 * count):
        if not any(left.values()):
            break
        mode = "fast" if rng.random() < fast else "exact"
        model = modes[mode]
        case = Case(model, folder / f"case{index}", rng)
        # Half of the early kills fall into the short time in which the first files are written, as
        # long as the machine is as fast as it was for the reference.
        earliest = model.begun if left["early"] % 2 and index < 3 * count else 0.0
        latest = model.first if left["early"] else model.whole
        state = case.kill(pace * earliest, pace * latest)
        kind = "later" if state == "after the first checkpoint" else "early"
        if state is None or not left[kind]:
            pace *= 1.25 if state and kind == "early" else 0.8
            shutil.rmtree(case.folder)
            continue
        left[kind] -= 1
        tallies[f"{mode}, {state}"].add(case.finish())
        progress(tallies, count)
    if any(left.values()):
        print(f"these kills were not made: {left}", file=sys.stderr)
        return 1
    return report(tallies, time.monotonic() - begun)


def main() -> None:
    """Parse the command line and run the cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--early", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fast", type=float, default=0.25, help="fraction with worker processes")
    options = parser.parse_args()
    with TemporaryDirectory(prefix="kills-", ignore_cleanup_errors=True) as folder:
        sys.exit(run(options.count, options.early, options.seed, Path(folder), options.fast))


if __name__ == "__main__":
    main()
