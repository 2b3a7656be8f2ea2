"""Commands in forked processes: modules are imported once, so that a start takes milliseconds.

Every worker process imports the modules at the head of this file too: keep them few.
"""

import contextlib
import gc
import hashlib
import json
import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

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


def preload() -> None:
    """Import and compile all that a training needs; torch must not compute anything yet.

    A fork would inherit the locks of torch's threads, but not the threads.
    """
    import torch
    from torch.utils.tensorboard import SummaryWriter  # noqa: F401

    import flipperctl.cli.hydra.sweeps
    import flipperctl.cli.main
    import flipperctl.requests.compose
    import flipperctl.training.run  # noqa: F401
    from flipperctl.env.flipper_env import FlipperEnv
    from flipperctl.plugging import plugins

    torch.set_num_threads(1)
    plugins.load()
    env = FlipperEnv(terrain="step")
    env.reset(seed=0)
    env.step(4)
    del env
    gc.collect()  # or a command frees the environment at any time, with an interrupt in between


@dataclass
class Command:
    """A ``flipperctl`` command in its own process and process group."""

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
        """The output of the command so far."""
        return self.log.read_text(errors="replace")

    def ended(self) -> bool:
        """Return whether the command has ended; ``code`` is then its exit code."""
        if self.code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.code = os.waitstatus_to_exitcode(status)
        return self.code is not None

    def wait(self, limit: float = LIMIT) -> bool:
        """Wait for the end; after ``limit`` [s], kill the group and return False."""
        while not self.ended():
            if self.age > limit:
                self.kill_group()
                return False
            time.sleep(0.002)
        return True

    def send(self, number: int, *, everyone: bool = False) -> None:
        """Send a signal to the main process, or to its workers too, unless it has ended."""
        while not self.ended():
            with contextlib.suppress(ProcessLookupError):  # it has no group of its own yet
                (os.killpg if everyone else os.kill)(self.pid, number)
                return
            time.sleep(0.001)

    def kill_group(self) -> None:
        """Kill the process and its workers."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        if self.code is None:
            _, status = os.waitpid(self.pid, 0)
            self.code = os.waitstatus_to_exitcode(status)

    def workers_ended(self) -> bool:
        """Return whether all workers have ended too; kill those that have not."""
        end = time.monotonic() + _GRACE
        while _members(self.pid):
            if time.monotonic() > end:
                self.kill_group()
                return False
            time.sleep(0.02)
        return True


def start(
    arguments: list[str],
    folder: Path,
    log: Path,
    out: Path | None = None,
    prepare: Callable[[], None] = lambda: None,
) -> Command:
    """Fork a process that runs ``flipperctl`` with these arguments in ``folder``.

    ``log`` gets what it writes, but ``out`` its standard output, if given; ``prepare`` is called
    in the process.
    """
    begun = time.monotonic()
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid:
        return Command(pid, log, begun)
    code = 70
    try:
        os.setsid()
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        for file, number in ((out or log, 1), (log, 2)):
            os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644), number)
        os.chdir(folder)
        prepare()
        from flipperctl.cli.main import main

        main(arguments)
    except SystemExit as left:
        code = left.code if isinstance(left.code, int) else 70 if left.code else 0
    except BaseException:  # noqa: BLE001 (the child must never return into the parent's code)
        import traceback

        traceback.print_exc()
    finally:
        with contextlib.suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def _members(group: int) -> list[int]:
    """Return the living processes of a process group, read from ``/proc``."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, _, leader = (entry / "stat").read_text().rpartition(")")[2].split()[:3]
            if int(leader) == group and state not in "ZX":
                found.append(int(entry.name))
    return found


def result(run: Path) -> dict[str, Any]:
    """Return the contents of a finished run without times; equal runs have equal results."""
    from flipperctl import checkpoint
    from flipperctl.text.files import read_csv

    found: dict[str, Any] = {}
    for name in (checkpoint.BEST, checkpoint.LAST):
        saved = checkpoint.read(run / name)
        digest = hashlib.sha256()
        for key in sorted(saved.tensors):
            digest.update(key.encode() + saved.tensors[key].numpy().tobytes())
        found[f"{name.stem} tensors"] = digest.hexdigest()
        found[f"{name.stem} document"] = _without_times(saved.document)
    found["metrics"] = [_without_times(row) for row in read_csv(run / "metrics.csv")]
    found["summary"] = _without_times(json.loads((run / "summary.json").read_text()))
    return found


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_times(v) for k, v in value.items() if k != "seconds"}
    return value


def differences(run: Path, reference: dict[str, Any]) -> list[str]:
    """Return the parts of a run that differ from the reference, or the error of reading the run."""
    try:
        found = result(run)
    except Exception as error:  # noqa: BLE001 (a missing or damaged part is a difference)
        return [f"{type(error).__name__}: {error}"]
    return [part for part, value in reference.items() if found[part] != value]


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


def report(tallies: dict[str, Tally], seconds: float) -> int:
    """Print a line for each kind; return the exit code."""
    for kind, tally in sorted(tallies.items()):
        print(f"{kind}: {tally}")
    found = sum(tally.violations for tally in tallies.values())
    print(f"{sum(t.count for t in tallies.values())} cases in {seconds:.0f} s, {found} violations")
    return 1 if found else 0
