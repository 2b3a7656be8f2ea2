"""Trainings and sweeps stopped at random times, and pairs that race for one run.

``python -m tests.long.kills --count 200 --early 50 --sweeps 40 --races 100 --seed 1`` kills 200
trainings, 50 of them before their first checkpoint, and resumes them; stops 40 sweeps by a signal
and types them again until they end; and starts 100 pairs of trainings in one run directory, of
which one must win and the other be refused. Each run must equal one that was left alone, bit for
bit. It prints a table and fails on any violation.
"""

import argparse
import contextlib
import csv
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.long.runs import differences, result

LIMIT = 120.0
"""Time after which a command counts as hanging [s]."""
_GRACE = 20.0
"""Time that workers have to end after their main process [s]."""
QUICK = [
    "terrain=step",
    "train.decisions=300",
    "train.validate_every=100",
    "train.checkpoint_every=70",
    "train.validation_episodes=1",
    "train.regret_episodes=1",
    "agent.learning_starts=50",
    "agent.epsilon_decisions=200",
    "agent.batch_size=32",
]
"""Arguments of a training of about a second."""
LAST = Path("checkpoints/last.safetensors")
RESUME = ["train", "--resume", "run"]
AGAIN = 0.3
"""Fraction of the resumed runs that are killed again, at most twice."""
WORKERS = 0.2
"""Fraction of the cases with worker processes."""
MODES = {mode: ["train", *QUICK, f"train.mode={mode}", "hydra.run.dir=run"]
         for mode in ("exact", "fast")}  # fmt: skip
_SHORT = ["train.decisions=150", "train.validate_every=75", "train.checkpoint_every=40"]
_SHORT += ["train.regret_episodes=0"]  # a signal leaves out the comparison at a run's end
SWEEP = ["train", "-m", *{o.partition("=")[0]: o for o in [*QUICK, *_SHORT]}.values()]
SWEEP += ["train.mode=exact", "seed=1,2,3", "hydra.sweep.dir=run"]
LAUNCHERS = {"basic": SWEEP}
LAUNCHERS["joblib"] = [*SWEEP, "hydra/launcher=joblib", "hydra.launcher.n_jobs=2"]
STOPS = {
    "SIGINT": (signal.SIGINT, False),
    "SIGINT to all": (signal.SIGINT, True),  # as Ctrl-C in a terminal
    "SIGTERM": (signal.SIGTERM, False),
    "SIGKILL": (signal.SIGKILL, False),
}
"""The signal, and whether the worker processes get it too."""
PAIRS = ("fresh + fresh", "resume + resume", "fresh + resume")
REFUSALS = ("is being trained by", "already holds a run", "no such run", "holds neither")


@dataclass
class Command:
    """A ``flipperctl`` command in its own process and process group."""

    process: subprocess.Popen[bytes]
    log: Path
    begun: float

    @classmethod
    def start(cls, arguments: list[str], folder: Path, log: Path) -> "Command":
        """Start the command in ``folder``; ``log`` gets what it writes."""
        words = [sys.executable, "-m", "flipperctl", *arguments]
        with log.open("ab") as file:
            process = subprocess.Popen(
                words,
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                start_new_session=True,
            )
        return cls(process, log, time.monotonic())

    @property
    def code(self) -> int | None:
        """The exit code; None while it runs."""
        return self.process.poll()

    @property
    def age(self) -> float:
        """Time since its start [s]."""
        return time.monotonic() - self.begun

    @property
    def text(self) -> str:
        """The output of the command so far."""
        return self.log.read_text(errors="replace")

    def wait(self, limit: float = LIMIT) -> bool:
        """Wait for the end; after ``limit`` [s], kill the group and return False."""
        try:
            self.process.wait(limit)
        except subprocess.TimeoutExpired:
            self.kill_group()
            return False
        return True

    def send(self, number: int, *, everyone: bool = False) -> None:
        """Send a signal to the main process, or to its workers too, unless it has ended."""
        with contextlib.suppress(ProcessLookupError):
            (os.killpg if everyone else os.kill)(self.process.pid, number)

    def kill_group(self) -> None:
        """Kill the process and its workers."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def workers_ended(self) -> bool:
        """Return whether all workers have ended too; kill those that have not."""
        end = time.monotonic() + _GRACE
        while _members(self.process.pid):
            if time.monotonic() > end:
                self.kill_group()
                return False
            time.sleep(0.02)
        return True


def _members(group: int) -> list[int]:
    """Return the living processes of a process group, read from ``/proc``."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, _, leader = (entry / "stat").read_text().rpartition(")")[2].split()[:3]
            if int(leader) == group and state not in "ZX":
                found.append(int(entry.name))
    return found


@dataclass
class Tally:
    """The results of the cases of one kind."""

    count: int = 0
    tracebacks: int = 0
    hangs: int = 0
    changes: int = 0
    wrong_codes: int = 0
    codes: Counter[int | None] = field(default_factory=Counter)

    def check(self, command: Command, *expected: int) -> None:
        """Count the exit code of a command, and whether it is one of the expected codes."""
        self.codes[command.code] += 1
        self.wrong_codes += command.code not in expected
        words = ("Traceback", "Exception ignored", "Fatal Python error", "error in flipperctl")
        self.tracebacks += any(word in command.text for word in words)

    def add(self, other: "Tally") -> None:
        """Add the numbers of another tally."""
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)

    @property
    def violations(self) -> int:
        """Number of violations."""
        return self.tracebacks + self.hangs + self.changes + self.wrong_codes


@dataclass(frozen=True)
class Reference:
    """Runs that were left alone: a training, or the jobs of a sweep."""

    arguments: list[str]
    found: dict[str, dict[str, Any]]
    """Result of each run, by the name of its folder in the case's."""
    begun: float
    """Time from the start until config.yaml existed [s]."""
    first: float
    """Time from the start until the first checkpoint existed [s]."""
    whole: float
    """Time from the start until the end [s]."""

    @classmethod
    def of(cls, arguments: list[str], folder: Path) -> "Reference":
        """Train to the end; return the runs with the times."""
        folder.mkdir()
        command = Command.start(arguments, folder, folder / "log")
        times = dict.fromkeys((Path("config.yaml"), LAST), 0.0)
        while command.code is None:
            for file, known in times.items():
                if not known and (folder / "run" / file).exists():
                    times[file] = command.age
            time.sleep(0.001)
        if command.code != 0:
            raise SystemExit(f"the reference failed: {command.text}")
        runs = [path.parent for path in sorted(folder.rglob("metrics.csv"))]
        found = {str(run.relative_to(folder)): result(run) for run in runs}
        return cls(arguments, found, *times.values(), command.age)


class Case:
    """A folder in which commands run, and the count of what they do wrong."""

    def __init__(self, model: Reference, folder: Path, rng: random.Random) -> None:
        self.model, self.folder, self.rng = model, folder, rng
        self.tally = Tally(count=1)
        folder.mkdir()

    def start(self, arguments: list[str], log: str = "log") -> Command:
        return Command.start(arguments, self.folder, self.folder / log)

    def stop(self, command: Command, at: float, number: int, *, everyone: bool = False) -> bool:
        """Send a signal at a time [s]; wait for all processes; return whether it came in time."""
        while command.age < at and command.code is None:
            time.sleep(0.001)
        in_time = command.code is None
        command.send(number, everyone=everyone)
        self.tally.hangs += not command.wait()
        if number == signal.SIGKILL:
            self.tally.hangs += not command.workers_ended()
        else:  # see ``end``
            command.kill_group()
        return in_time and command.code != 0

    def end(self, arguments: list[str], expected: int) -> None:
        """Run a command to its end."""
        command = self.start(arguments)
        self.tally.hangs += not command.wait()
        self.tally.check(command, expected)
        self.tally.hangs += not command.workers_ended()

    def compare(self, text: str, *faults: str) -> Tally:
        """Compare the runs with the reference; keep the folder if something is wrong."""
        wrong = [*faults]
        for run, found in self.model.found.items():
            wrong += [f"{run}: {part}" for part in differences(self.folder / run, found)]
        self.tally.changes += bool(wrong)
        if self.tally.violations:
            logs = "".join(log.read_text() for log in sorted(self.folder.glob("log*")))
            print(f"{self.folder}, {text}: {wrong}; {logs}", file=sys.stderr)
        else:
            shutil.rmtree(self.folder)
        return self.tally

    def begun(self) -> bool:
        """Return whether there is a run, which can be resumed."""
        return any((self.folder / "run" / name).exists() for name in ("config.yaml", LAST))


def resumed(case: Case) -> Tally:
    """Resume a killed run, perhaps kill it again, and compare it."""
    for _ in range(2):
        if case.begun() and case.rng.random() < AGAIN:
            at = case.rng.uniform(0.0, case.model.whole)
            case.stop(case.start(RESUME), at, signal.SIGKILL)
    if not case.begun():  # resuming fails, and it is started again
        case.end(RESUME, 2)
        case.end(case.model.arguments, 0)
    else:
        case.end(RESUME, 0)
    return case.compare("killed")


def sweep(case: Case, stop: str) -> Tally:
    """Stop a sweep up to three times, type it again until it ends, and compare its runs."""
    number, everyone = STOPS[stop]
    # Before the command has its own handler, SIGTERM ends it as it ends any process.
    expected = (-number, 0) if number == signal.SIGKILL else (130, -signal.SIGTERM, 0)
    for _ in range(case.rng.randint(1, 3)):
        command = case.start(case.model.arguments)
        case.stop(command, case.rng.uniform(0.0, case.model.whole), number, everyone=everyone)
        case.tally.check(command, *expected)
        if command.code == 0:
            break
    case.end(case.model.arguments, 0)
    with (case.folder / "run" / "sweep.csv").open(newline="") as file:
        states = [row["state"] for row in csv.DictReader(file)]
    wrong = states != ["finished"] * len(case.model.found)
    return case.compare(stop, *[f"sweep.csv: {states}"] * wrong)


def race(case: Case, pair: str, stopped: Path) -> Tally | None:
    """Let two commands race; return None if the second one came after the end."""
    if pair == "resume + resume":
        shutil.copytree(stopped / "run", case.folder / "run")
    known = {"fresh": case.model.arguments, "resume": RESUME}
    words = [known[word] for word in pair.split(" + ")]
    case.rng.shuffle(words)
    delay = case.rng.choice([0.0, 0.0, case.rng.uniform(0.0, 0.6)]) * case.model.whole
    first = case.start(words[0], "log0")
    while first.age < delay:
        time.sleep(0.001)
    both = [first, case.start(words[1], "log1")]
    for command in both:
        case.tally.hangs += not command.wait()
        case.tally.hangs += not command.workers_ended()
    if any("nothing left to do" in command.text for command in both):
        shutil.rmtree(case.folder)
        return None
    for command in both:
        case.tally.check(command, 0, 2)
        refused = [line for line in command.text.splitlines() if line.startswith("error: ")]
        right = len(refused) == 1 and any(word in refused[0] for word in REFUSALS)
        case.tally.wrong_codes += command.code == 2 and not right
    case.tally.wrong_codes += sorted(command.code or 0 for command in both) != [0, 2]
    return case.compare(f"{pair}, {delay:.3f} s")


class Cases:
    """All cases, drawn by one generator."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.rng, self.folder, self.count = random.Random(seed), folder, 0
        self.models: dict[str, Reference] = {}

    def case(self, *names: str) -> tuple[str, Case]:
        """Return a case of the first kind, or some of the second, which has workers."""
        name = names[self.rng.random() < WORKERS]
        if name not in self.models:
            self.models[name] = Reference.of({**MODES, **LAUNCHERS}[name], self.folder / name)
        self.count += 1
        return name, Case(self.models[name], self.folder / f"case{self.count}", self.rng)

    def kills(self, count: int, early: int) -> Iterator[tuple[str, Tally]]:
        """Kill ``count`` trainings, ``early`` of them before their first checkpoint."""
        left = {"early": early, "later": count - early}
        pace = 1.0  # time that a case takes for each second of the reference
        for index in range(20 * count):
            if not any(left.values()):
                return
            name, case = self.case(*MODES)
            model = case.model
            # Half of the early kills fall into the short time in which the first files are written,
            # as long as the machine is as fast as it was for the reference.
            soon = model.begun if left["early"] % 2 and index < 3 * count else 0.0
            late = model.first if left["early"] else model.whole
            at = self.rng.uniform(pace * soon, pace * late)
            killed = case.stop(case.start(model.arguments), at, signal.SIGKILL)
            kind = "later" if (case.folder / "run" / LAST).exists() else "early"
            if not killed or not left[kind]:
                pace *= 1.25 if killed and kind == "early" else 0.8
                shutil.rmtree(case.folder)
                continue
            left[kind] -= 1
            state = "with a run" if case.begun() else "before config.yaml"
            yield f"{name}, killed {kind} {state}", resumed(case)
        raise SystemExit(f"these kills were not made: {left}")

    def sweeps(self, count: int) -> Iterator[tuple[str, Tally]]:
        """Stop sweeps by one signal after the other."""
        for index in range(count):
            stop = list(STOPS)[index % len(STOPS)]
            name, case = self.case(*LAUNCHERS)
            yield f"{name}, {stop}", sweep(case, stop)

    def races(self, count: int) -> Iterator[tuple[str, Tally]]:
        """Let pairs of commands race for one run."""
        stopped: dict[str, Path] = {}
        done = 0
        for _ in range(5 * count):
            if done == count:
                return
            pair = PAIRS[done % len(PAIRS)]
            name, case = self.case(*MODES)
            if name not in stopped:
                made = Case(case.model, self.folder / f"stopped-{name}", self.rng)
                command, metrics = made.start(case.model.arguments), made.folder / "run/metrics.csv"
                while not metrics.exists() or metrics.read_text().count("\n") < 3:
                    time.sleep(0.001)
                if not made.stop(command, 0.0, signal.SIGTERM):
                    raise SystemExit(f"it was to be interrupted: {command.text}")
                stopped[name] = made.folder
            if (tally := race(case, pair, stopped[name])) is not None:
                done += 1
                yield f"{name}, {pair}", tally
        raise SystemExit(f"only {done} of {count} pairs met")


def report(tallies: dict[str, Tally], seconds: float) -> int:
    """Print a line for each kind; return the exit code."""
    for kind, tally in sorted(tallies.items()):
        print(f"{kind}: {tally}")
    found = sum(tally.violations for tally in tallies.values())
    print(f"{sum(t.count for t in tallies.values())} cases in {seconds:.0f} s, {found} violations")
    return 1 if found else 0


def main() -> None:
    """Parse the command line and run the cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name, count in (("count", 200), ("early", 50), ("sweeps", 40), ("races", 100), ("seed", 1)):
        parser.add_argument(f"--{name}", type=int, default=count)
    options = parser.parse_args()
    begun = time.monotonic()
    tallies: dict[str, Tally] = defaultdict(Tally)
    with TemporaryDirectory(prefix="kills-", ignore_cleanup_errors=True) as folder:
        cases = Cases(options.seed, Path(folder))
        found = (
            *(cases.kills(options.count, options.early), cases.sweeps(options.sweeps)),
            cases.races(options.races),
        )
        for cases_of_one_kind in found:
            for kind, tally in cases_of_one_kind:
                tallies[kind].add(tally)
        sys.exit(report(tallies, time.monotonic() - begun))


if __name__ == "__main__":
    main()
