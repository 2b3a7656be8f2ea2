"""Trainings on a Ray cluster with fewer free CPUs than workers, some of them stopped by a signal.

``python -m tests.long.few_cpus --count 20 --seed 1`` starts a cluster for each case, with 0, 1 or 2
CPUs free, trains on it and prints a table of the cases. With a CPU free a run finishes and says how
many workers have got none; without one it fails with one error; stopped, it is resumed to its end.
"""

import argparse
import os
import random
import re
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.long.forked import LIMIT, QUICK, Command, Tally, preload, start
from tests.long.ray_cluster import LOOPBACK, RayCluster

STOPS = {"SIGINT": signal.SIGINT, "SIGTERM": signal.SIGTERM}
PHASES = ("placing", "working", "validating")
_TO_STOP = 20.0
"""Longest time from a signal to the end [s]."""
_TO_FAIL = 30.0
"""Longest time from the start to the error, beyond the patience [s]."""
_TO_SAY = 15.0
"""Time of training after which the workers without a CPU must have been named [s]."""
_TO_LEAVE = 20.0
"""Time that a command's processes have to end after it [s]."""
_SAID = re.compile(r"(\d+) of (\d+) Ray workers \(collector\.workers\) have no CPU")


@dataclass
class Case:
    """What is drawn for a case, and what was found."""

    free: int
    taken: int
    workers: int
    stop: str
    phase: str
    patience: float
    decisions: int
    code: int | None = None
    seconds: float = 0.0
    said: str = "-"
    faults: list[str] = field(default_factory=list)

    @classmethod
    def draw(cls, index: int, rng: random.Random) -> "Case":
        """Draw a case; one in three has no free CPU, and about two in five are stopped."""
        free, stop = index % 3, rng.choice([*STOPS, *[""] * 3])
        phases = PHASES if free else PHASES[:1]
        return cls(
            free=free,
            taken=rng.randint(0 if free else 1, 2),
            workers=rng.randint(1, 8),
            stop=stop,
            phase=rng.choice(phases) if stop else "",
            patience=300.0 if free or stop else float(rng.randint(2, 6)),
            decisions=100_000 if stop else rng.choice([300, 8000]),
        )

    def arguments(self, address: str) -> list[str]:
        """Return the words of the training."""
        settings = dict(word.split("=") for word in QUICK)
        settings |= {"train.decisions": self.decisions, "train.validate_every": 1000}
        if self.phase == "validating":
            settings |= {"train.validate_every": 60, "train.validation_episodes": 100}
        settings |= {
            "train.mode": "fast",
            "collector": "ray",
            "collector.address": address,
            "collector.workers": self.workers,
            "collector.patience": self.patience,
            "hydra.run.dir": "run",
        }
        return ["train", *(f"{key}={value}" for key, value in settings.items())]

    def row(self) -> tuple[str, ...]:
        """Return the cells of the case."""
        numbers = (self.free, self.taken, self.workers, self.decisions)
        stop = f"{self.stop} {self.phase}" if self.stop else "-"
        found = "; ".join(self.faults) or "-"
        return (*map(str, numbers), stop, str(self.code), f"{self.seconds:.0f}", self.said, found)


HEADING = (
    "free",
    "taken",
    "workers",
    "decisions",
    "stop",
    "code",
    "s",
    "without CPU",
    "violations",
)


class Trial:
    """A case in a folder of its own."""

    def __init__(self, case: Case, folder: Path, rng: random.Random) -> None:
        self.case, self.folder, self.rng = case, folder, rng
        self.run, self.text = folder / "run", ""
        folder.mkdir()

    def play(self) -> None:
        """Run the case; what is violated stands in ``case.faults``."""
        case = self.case
        with RayCluster(case.free + case.taken, case.taken, self.folder / "r") as cluster:
            words = case.arguments(cluster.address)
            command = start(words, self.folder, self.folder / "log")
            if case.stop:
                self._stop(command)
                cluster.give_free()
                self._resume()
            else:
                self._end(command)
                self._expect(command, 0) if case.free else self._check_refusal(command)
        if left := _until_none(lambda: [words for words, _ in _users(self.folder)]):
            case.faults.append(f"left after the cluster: {left}")
        if case.faults:
            print(f"{self.folder}: {case.row()}\n{self.text}", file=sys.stderr, flush=True)
        else:
            shutil.rmtree(self.folder)

    def _stop(self, command: Command) -> None:
        """Send the signal at a random time of the phase."""
        begun = self.run / ("config.yaml" if self.case.phase == "placing" else "metrics.csv")
        lines = 1 if self.case.phase == "placing" else 2
        while not command.ended() and command.age < 60 and _lines(begun) < lines:
            time.sleep(0.01)
        at = command.age + self.rng.uniform(0.0, 6.0)
        while not command.ended() and command.age < at:
            time.sleep(0.01)
        command.send(STOPS[self.case.stop])
        sent = command.age
        self._end(command)
        if (after := self.case.seconds - sent) > _TO_STOP:
            self.case.faults.append(f"ended {after:.0f} s after the signal")
        self._expect(command, 130)
        if "all is saved" not in command.text:
            self.case.faults.append("it does not say that all is saved")

    def _end(self, command: Command) -> None:
        """Wait for the end of the command and of its workers; check what it said."""
        case, first = self.case, 0.0
        while not command.ended() and command.age < LIMIT:
            if not first and _lines(self.run / "metrics.csv") > 1:
                first = command.age
            time.sleep(0.02)
        if not command.wait():
            case.faults.append(f"still running after {LIMIT:.0f} s")
        case.code, case.seconds = command.code, command.age
        self.text += command.text
        if left := _until_none(lambda: _actors(self.folder)):
            case.faults.append(f"left after the command: {left}")
        self._check_words(command, long=bool(first) and case.seconds > first + _TO_SAY)

    def _check_words(self, command: Command, *, long: bool) -> None:
        """Check how many workers are said to have no CPU; ``long``: it must have been said."""
        case, said = self.case, _SAID.findall(command.text)
        without = max(0, case.workers - case.free)
        case.said = " ".join(count for count, _ in said) or "-"
        if said and said != [(str(without), str(case.workers))]:
            case.faults.append(f"{without} workers have no CPU, not {case.said}")
        if long and without and not said:
            case.faults.append(f"it does not say that {without} workers have no CPU")

    def _check_refusal(self, command: Command) -> None:
        """Check the one error of a run that gets no CPU."""
        self._expect(command, 1)
        errors = [line for line in command.text.splitlines() if line.startswith("error: ")]
        if len(errors) != 1 or "no Ray worker got a CPU" not in errors[0]:
            self.case.faults.append(f"errors: {errors}")
        if self.case.seconds > self.case.patience + _TO_FAIL:
            self.case.faults.append("it fails too late")

    def _resume(self) -> None:
        """Resume the stopped run on the same cluster, all of whose CPUs are free now."""
        from flipperctl import checkpoint
        from flipperctl.training.listeners import read_rows

        case = self.case
        saved = checkpoint.read(self.run / checkpoint.LAST)
        before = read_rows(self.run / "metrics.csv")
        last = int(before[-1]["decision"]) if before else 0
        budget = last + 100
        command = start(
            ["train", "--resume", "run", f"train.decisions={budget}"],
            self.folder,
            self.folder / "resumed",
        )
        if not command.wait():
            case.faults.append("the resumed run hangs")
        self.text += command.text
        self._expect(command, 0)
        if left := _until_none(lambda: _actors(self.folder)):
            case.faults.append(f"left after the resumed run: {left}")
        after = read_rows(self.run / "metrics.csv")
        if after[: len(before)] != before or len(after) <= len(before):
            case.faults.append("episodes of before are not kept")
        if checkpoint.read(self.run / checkpoint.LAST).document == saved.document:
            case.faults.append("the resumed run has saved nothing")

    def _expect(self, command: Command, code: int) -> None:
        tally = Tally()
        tally.check(command, code)
        if tally.wrong_codes:
            self.case.faults.append(f"exit code {command.code}, not {code}")
        if tally.tracebacks:
            self.case.faults.append("traceback")


def _lines(path: Path) -> int:
    return path.read_text().count("\n") if path.exists() else 0


def _until_none(find: Callable[[], list[str]]) -> list[str]:
    """Wait until nothing is found, and return what is found after ``_TO_LEAVE``."""
    end = time.monotonic() + _TO_LEAVE
    while (found := find()) and time.monotonic() < end:
        time.sleep(0.2)
    return found


def _actors(folder: Path) -> list[str]:
    """Return the processes of a command and its actors, which are not the cluster's own."""
    logs = {str(folder / name) for name in ("log", "resumed")}
    return [text for text, files in _users(folder) if "StartedActor" in text or logs & files]


def _users(folder: Path) -> Iterator[tuple[str, set[str]]]:
    """Yield the words and the open files of each process that has a file in the folder open."""
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            files = {str(link.readlink()) for link in (entry / "fd").iterdir()}
            words = (entry / "cmdline").read_text().replace("\0", " ").strip()
        except OSError:  # it has ended
            continue
        if any(name.startswith(f"{folder}/") for name in files) and entry.name != str(os.getpid()):
            yield f"{entry.name} {words[:60]}", files


def run(count: int, seed: int, folder: Path) -> int:
    """Play ``count`` cases and print their table; return the exit code."""
    begun = time.monotonic()
    rng = random.Random(seed)
    os.environ.update(LOOPBACK)  # before Ray is imported, for the commands
    preload()
    rows = [HEADING]
    found = 0
    for index in range(count):
        case = Case.draw(index, rng)
        Trial(case, folder / str(index), rng).play()
        rows.append(case.row())
        found += len(case.faults)
        print(f"{index + 1} of {count}, {found} violations", file=sys.stderr, flush=True)
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEADING))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)))
    print(f"{count} cases in {time.monotonic() - begun:.0f} s, {found} violations")
    return 1 if found else 0


def main() -> None:
    """Parse the command line and run the cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    with TemporaryDirectory(prefix="few-", ignore_cleanup_errors=True) as folder:
        sys.exit(run(options.count, options.seed, Path(folder)))


if __name__ == "__main__":
    main()
