"""Commands in forked processes: everything is imported once, so that a start costs milliseconds.

What is imported here at the head is imported by every worker process too: keep it light.
"""

import contextlib
import hashlib
import json
import os
import signal
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

LIMIT = 120.0
"""Time after which a command counts as hanging [s]."""
_GRACE = 20.0
"""Time that workers have to leave after their main process [s]."""

QUICK = [
    "terrain=step",
    "train.decisions=300",
    "train.validate_every=100",
    "train.checkpoint_every=70",
    "train.validation_episodes=1",
    "agent.learning_starts=50",
    "agent.epsilon_decisions=200",
    "agent.batch_size=32",
]
"""A training of about a second."""


def preload() -> None:
    """Import what a training imports, and compile what it compiles; torch computes nothing yet.

    A fork would inherit the locks of torch's threads, but not the threads.
    """
    import torch
    from torch.utils.tensorboard import SummaryWriter  # noqa: F401

    import flipperctl.cli.compose
    import flipperctl.cli.main
    import flipperctl.cli.optuna_search
    import flipperctl.cli.training  # noqa: F401
    from flipperctl import plugins
    from flipperctl.env.flipper_env import FlipperEnv

    torch.set_num_threads(1)
    plugins.load()
    env = FlipperEnv(terrain="step")
    env.reset(seed=0)
    env.step(4)


@dataclass
class Command:
    """``flipperctl`` in a process of its own, with a process group of its own."""

    pid: int
    log: Path
    begun: float
    code: int | None = None

    @property
    def age(self) -> float:
        """Time since its start [s]."""
        return time.monotonic() - self.begun

    @property
    def text(self) -> str:
        """What it printed."""
        return self.log.read_text(errors="replace")

    def ended(self) -> bool:
        """Whether it has ended; ``code`` then says how."""
        if self.code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.code = os.waitstatus_to_exitcode(status)
        return self.code is not None

    def wait(self, limit: float = LIMIT) -> bool:
        """Wait for its end; False, and the whole group is killed, if it does not come."""
        while not self.ended():
            if self.age > limit:
                self.kill_group()
                return False
            time.sleep(0.002)
        return True

    def kill(self) -> bool:
        """Kill the main process alone, as the system does; False if it had ended."""
        if self.ended():
            return False
        os.kill(self.pid, signal.SIGKILL)
        self.wait()
        return self.code == -signal.SIGKILL

    def kill_group(self) -> None:
        """Kill the process and its workers."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        if self.code is None:
            _, status = os.waitpid(self.pid, 0)
            self.code = os.waitstatus_to_exitcode(status)

    def left_alone(self) -> bool:
        """Whether all its workers have left too; those that have not are killed."""
        end = time.monotonic() + _GRACE
        while _members(self.pid):
            if time.monotonic() > end:
                self.kill_group()
                return False
            time.sleep(0.02)
        return True


def start(arguments: list[str], folder: Path, log: Path) -> Command:
    """Fork a process that runs ``flipperctl`` with these arguments in ``folder``."""
    begun = time.monotonic()
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid:
        return Command(pid, log, begun)
    code = 70
    try:
        os.setsid()
        _redirect(log)
        os.chdir(folder)
        from flipperctl.cli.main import main

        main(arguments)
    except SystemExit as left:
        code = left.code if isinstance(left.code, int) else 70
    except BaseException:  # noqa: BLE001 (the child must never return into the parent's code)
        import traceback

        traceback.print_exc()
    finally:
        with contextlib.suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def _redirect(log: Path) -> None:
    nothing = os.open(os.devnull, os.O_RDONLY)
    out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for source, target in ((nothing, 0), (out, 1), (out, 2)):
        os.dup2(source, target)


def _members(group: int) -> list[int]:
    """The processes of a group that live, after the table of processes."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, _, leader = (entry / "stat").read_text().rpartition(")")[2].split()[:3]
            if int(leader) == group and state not in "ZX":
                found.append(int(entry.name))
    return found


def result(run: Path) -> dict[str, Any]:
    """What a finished run holds, without clocks: equal runs have equal results."""
    from flipperctl import checkpoint
    from flipperctl.training.events import read_rows

    found: dict[str, Any] = {}
    for name in (checkpoint.BEST, checkpoint.LAST):
        saved = checkpoint.read(run / name)
        digest = hashlib.sha256()
        for key in sorted(saved.tensors):
            digest.update(key.encode() + saved.tensors[key].numpy().tobytes())
        found[f"{name.stem} tensors"] = digest.hexdigest()
        found[f"{name.stem} document"] = _timeless(saved.document)
    found["metrics"] = [_timeless(row) for row in read_rows(run / "metrics.csv")]
    found["summary"] = _timeless(json.loads((run / "summary.json").read_text()))
    return found


def _timeless(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _timeless(v) for k, v in value.items() if k != "seconds"}
    return value


def differences(run: Path, reference: dict[str, Any]) -> list[str]:
    """The parts in which a run's result differs from the reference's, or that cannot be read."""
    try:
        found = result(run)
    except Exception as error:  # noqa: BLE001 (a part that is missing or damaged is a finding)
        return [f"{type(error).__name__}: {error}"]
    return [part for part, value in reference.items() if found[part] != value]


@dataclass
class Tally:
    """What became of the cases of one kind."""

    count: int = 0
    tracebacks: int = 0
    hangs: int = 0
    changes: int = 0
    wrong_codes: int = 0
    codes: Counter[int | None] = field(default_factory=Counter)

    def check(self, command: Command, *expected: int) -> None:
        """Note how a command ended, against the exit codes that are right."""
        self.codes[command.code] += 1
        self.wrong_codes += command.code not in expected
        words = ("Traceback", "Exception ignored", "Fatal Python error", "error in flipperctl")
        self.tracebacks += any(word in command.text for word in words)

    def add(self, other: "Tally") -> None:
        """Add the numbers of another."""
        for name in ("count", "tracebacks", "hangs", "changes", "wrong_codes"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.codes.update(other.codes)

    @property
    def violations(self) -> int:
        """How many findings there are."""
        return self.tracebacks + self.hangs + self.changes + self.wrong_codes


def progress(tallies: dict[str, Tally], count: int) -> None:
    """Tell every tenth case on stderr."""
    done = sum(tally.count for tally in tallies.values())
    if done % 10 == 0:
        found = sum(tally.violations for tally in tallies.values())
        print(f"{done} of {count}, {found} violations", file=sys.stderr, flush=True)


def report(tallies: dict[str, Tally], seconds: float) -> int:
    """Print the table; returns the exit code."""
    heading = ("kind", "count", "tracebacks", "hangs", "silent changes", "wrong codes", "codes")
    rows = [
        (
            kind,
            *(str(n) for n in (t.count, t.tracebacks, t.hangs, t.changes, t.wrong_codes)),
            " ".join(f"{code}:{n}" for code, n in sorted(t.codes.items(), key=str)),
        )
        for kind, t in sorted(tallies.items())
    ]
    widths = [max(len(row[i]) for row in [heading, *rows]) for i in range(len(heading))]
    for row in [heading, *rows]:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)))
    found = sum(tally.violations for tally in tallies.values())
    print(f"{sum(t.count for t in tallies.values())} cases in {seconds:.0f} s, {found} violations")
    return 1 if found else 0
