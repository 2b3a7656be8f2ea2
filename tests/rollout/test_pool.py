"""The worker pool: it replaces a process that dies and runs the remaining calls."""

import itertools
import os
import signal
import sys
import time
from concurrent.futures import Future
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from flipperctl.errors import FlipperctlError
from flipperctl.rollout.pool import WorkerDiedError, WorkerPool
from flipperctl.training.trainer import Trainer
from tests.rollout.notes import Notes
from tests.short import short_config, trainer


def initialize() -> None:
    """Prepare nothing."""


def double(number: int) -> int:
    return 2 * number


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fail() -> None:
    raise FlipperctlError("on purpose")


def value(name: str) -> str | None:
    return os.environ.get(name)


def wait_for(path: Path, limit: float = 20.0) -> bool:
    end = time.monotonic() + limit
    while not path.exists() and time.monotonic() < end:
        time.sleep(0.01)
    return path.exists()


def touch(path: Path) -> None:
    path.touch()


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A script that this process seems to run, and that would end a worker."""
    file = tmp_path / "script.py"
    file.write_text("raise SystemExit(1)")
    module = ModuleType("__main__")
    module.__file__ = str(file)
    monkeypatch.setitem(sys.modules, "__main__", module)


@pytest.mark.usefixtures("script")
def test_a_dead_worker_is_replaced_and_runs_the_calls_after_it() -> None:
    workers = WorkerPool(2, initialize, ())
    try:
        assert workers.submit(double, 1).result() == 2
        dead, after = workers.submit(die), [workers.submit(double, n) for n in range(4)]
        with pytest.raises(WorkerDiedError, match=r"worker process [01] died"):
            dead.result()
        assert [call.result() for call in after] == [0, 2, 4, 6]
        for pid in workers.process_ids():  # while they wait for calls
            os.kill(pid, signal.SIGKILL)
        while any(worker._child is not None and worker._child.idle for worker in workers._workers):
            time.sleep(0.001)
        assert workers.submit(double, 2).result() == 4
    finally:
        workers.close()


def test_a_worker_that_always_dies_ends_its_calls_with_a_reason() -> None:
    workers = WorkerPool(2, initialize, ())
    try:
        for _ in range(2):
            with pytest.raises(WorkerDiedError):
                workers.submit(die).result()
        with pytest.raises(FlipperctlError, match="3 times in a row"):
            workers.submit(die).result()
    finally:
        workers.close()


def test_an_error_in_a_worker_is_raised_unchanged() -> None:
    workers = WorkerPool(2, initialize, ())
    try:
        with pytest.raises(FlipperctlError, match="on purpose"):
            workers.submit(fail).result()
        assert workers.submit(double, 3).result() == 6
    finally:
        workers.close()


def test_a_long_call_holds_up_no_other(tmp_path: Path) -> None:
    """The first call waits for the last one, which any fixed division puts behind it or not."""
    workers = WorkerPool(2, initialize, ())
    try:
        long = workers.submit(wait_for, tmp_path / "last")
        others = [workers.submit(double, number) for number in range(9)]
        last = workers.submit(touch, tmp_path / "last")
        assert long.result(timeout=30) is True
        assert last.result() is None
        assert [call.result() for call in others] == [2 * number for number in range(9)]
    finally:
        workers.close()


def test_closing_ends_a_call_that_is_under_way(tmp_path: Path) -> None:
    workers = WorkerPool(2, initialize, ())
    call = workers.submit(wait_for, tmp_path / "never", 60.0)
    queued = [workers.submit(wait_for, tmp_path / "never", 60.0) for _ in range(3)]
    while not call.running() or not workers.process_ids():
        time.sleep(0.01)
    begun = time.monotonic()
    workers.close()
    assert time.monotonic() - begun < 10
    with pytest.raises(WorkerDiedError):
        call.result(timeout=0)
    assert queued[-1].cancelled()


@pytest.mark.parametrize("count", [1, 2])  # spawned, and forked from a server
def test_workers_have_the_environment_of_now(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The server, which lives as long as this process, has that of its start."""
    found = []
    for text in ("first", "second"):
        monkeypatch.setenv("WORKER_SHALL_KNOW", text)
        workers = WorkerPool(count, initialize, ())
        try:
            found.append(workers.submit(value, "WORKER_SHALL_KNOW").result())
        finally:
            workers.close()
    assert found == ["first", "second"]


@pytest.mark.parametrize("count", [1, 2])  # spawned, and forked from a server
def test_what_stops_a_whole_group_of_processes_leaves_the_workers_at_work(count: int) -> None:
    """Ctrl-C and a scheduler's SIGTERM reach every process; the learner stops its workers."""
    workers = WorkerPool(count, initialize, ())
    try:
        call = workers.submit(double, 1)
        while not workers.process_ids():
            time.sleep(0.001)
        for number in (signal.SIGINT, signal.SIGTERM):  # while it is starting
            os.kill(workers.process_ids()[0], number)
        assert call.result() == 2
        for number in (signal.SIGINT, signal.SIGTERM):
            os.kill(workers.process_ids()[0], number)
        assert workers.submit(double, 2).result() == 4
        assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == set()
    finally:
        workers.close()


def test_a_training_run_continues_when_a_worker_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = itertools.count()
    submit = WorkerPool.submit

    def killing(self: WorkerPool, *call: Any) -> Future[Any]:
        pids = self.process_ids() if next(calls) == 8 else []
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)  # the episode of this call cannot end
        future = submit(self, *call)
        while pids and not future.running():
            time.sleep(0.001)
        time.sleep(0.2 * bool(pids))
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
        return future

    monkeypatch.setattr(WorkerPool, "submit", killing)
    learner: Trainer = trainer(short_config(**{"train.mode": "fast", "train.workers": 2}), tmp_path)
    listener = Notes()
    learner.listeners.append(listener)
    summary = learner.run()
    assert summary["finished"] is True
    assert summary["decisions"] == 600
    assert summary["lost_episodes"] == len(listener.notes) >= 1
    assert "a worker died and is replaced; its episode" in listener.notes[0]
