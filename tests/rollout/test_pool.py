"""The worker pool: it replaces a process that dies, runs the remaining calls, imports nothing here.

Worker processes import what this process has imported, and leave it as it was.
"""

import errno
import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from flipperctl.errors import FlipperctlError
from flipperctl.rollout import pool as children
from flipperctl.rollout.pool import ProcessHost, WorkerDiedError, WorkerPool, python_environment
from flipperctl.training.trainer import Trainer
from tests.rollout.calls import die, die_first, fail, initialize, mask, touch, wait_for
from tests.rollout.notes import Notes, process_ids
from tests.short import short_config, trainer

HOSTILE = ("random", "signal", "queue", "numbers", "numpy", "torch", "pickle", "socket", "struct")
PLACES = """
from flipperctl.rollout.pool import ProcessHost, WorkerPool
pool = WorkerPool({count}, int, ())
here = "(getattr(m, '__file__', '') or '').startswith(__import__('os').getcwd())"
names = "[n for n, m in __import__('sys').modules.items() if " + here + "]"
print(pool.submit(eval, names).result())
pool.close()
"""
both = pytest.mark.parametrize(  # forked from a server, and spawned
    "count", [2, pytest.param(1, marks=pytest.mark.long)]
)


@pytest.fixture
def hostile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory: it holds files named like modules, and a folder ``flipperctl``."""
    (tmp_path / "flipperctl").mkdir()
    for name in HOSTILE:
        (tmp_path / f"{name}.py").write_text("raise SystemExit('imported')")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def workers() -> Iterator[WorkerPool]:
    """Two workers."""
    with closing(WorkerPool(2, initialize, ())) as pool:
        yield pool


def asked(count: int, function: Any, *arguments: Any, first: Any = ()) -> Any:
    with closing(WorkerPool(count, initialize, first)) as pool:
        return pool.submit(function, *arguments).result()


def test_a_dead_worker_is_replaced_and_runs_the_calls_after_it() -> None:
    with closing(WorkerPool(2, initialize, ())) as workers:
        assert workers.submit(abs, -1).result() == 1
        dead, after = workers.submit(die), [workers.submit(abs, -n) for n in range(4)]
        with pytest.raises(WorkerDiedError, match=r"worker process [01] died"):
            dead.result()
        assert [call.result() for call in after] == [0, 1, 2, 3]
        killed = [host for host in workers._hosts.values() if isinstance(host, ProcessHost)]
        for host in killed:  # while they wait for calls, or start
            os.kill(host.pid, signal.SIGKILL)
        while any(host.alive for host in killed):
            time.sleep(0.001)
        assert [workers.submit(abs, -n).result() for n in range(4)] == [0, 1, 2, 3]


def test_a_long_message_of_a_process_that_dies_blocks_nothing() -> None:
    """CPython issue 94777: it would stay in a pipe, and the interpreter would wait for it."""
    with closing(WorkerPool(2, initialize, ())) as workers:
        long = bytes(2**22)
        assert workers.submit(len, long).result() == 2**22
        assert workers.submit(bytes, 2**22).result() == long
        for pid in process_ids(workers):
            os.kill(pid, signal.SIGSTOP)
        call = workers.submit(len, long)
        while not call.running():
            time.sleep(0.001)
        for pid in process_ids(workers):
            os.kill(pid, signal.SIGKILL)
        with pytest.raises(WorkerDiedError):
            call.result()
        assert workers.submit(abs, -1).result() == 1


def test_a_worker_that_dies_as_it_starts_costs_no_call(tmp_path: Path) -> None:
    with closing(WorkerPool(1, die_first, (tmp_path / "died",))) as workers:
        assert workers.submit(abs, -1).result() == 1
    assert (tmp_path / "died").exists()


def test_an_error_in_a_worker_is_raised_unchanged_and_many_deaths_end_it(
    workers: WorkerPool,
) -> None:
    for error in (FlipperctlError("on purpose"), EOFError("on purpose")):
        with pytest.raises(type(error), match="on purpose"):
            workers.submit(fail, error).result()
    assert workers.submit(abs, -3).result() == 3
    for _ in range(2):
        with pytest.raises(WorkerDiedError):
            workers.submit(die).result()
    with pytest.raises(FlipperctlError, match="3 times in a row"):
        workers.submit(die).result()


def test_a_long_call_holds_up_no_other(tmp_path: Path, workers: WorkerPool) -> None:
    """The first call waits for the last one, which any fixed division puts behind it or not."""
    long = workers.submit(wait_for, tmp_path / "last")
    others = [workers.submit(abs, -number) for number in range(9)]
    last = workers.submit(touch, tmp_path / "last")
    assert long.result(timeout=30) is True
    assert last.result() is None
    assert [call.result() for call in others] == list(range(9))


def test_closing_ends_a_call_that_is_under_way(tmp_path: Path) -> None:
    workers = WorkerPool(2, initialize, ())
    call = workers.submit(wait_for, tmp_path / "never", 60.0)
    queued = [workers.submit(wait_for, tmp_path / "never", 60.0) for _ in range(3)]
    while not call.running() or not process_ids(workers):
        time.sleep(0.01)
    begun = time.monotonic()
    workers.close()
    assert time.monotonic() - begun < 10
    with pytest.raises(WorkerDiedError):
        call.result(timeout=0)
    assert queued[-1].cancelled()


@both
def test_what_stops_a_whole_group_of_processes_leaves_the_workers_at_work(count: int) -> None:
    """Ctrl-C and a scheduler's SIGTERM reach every process; the learner stops its workers."""
    with closing(WorkerPool(count, initialize, ("torch",))) as workers:
        call = workers.submit(abs, -1)
        while not process_ids(workers):
            time.sleep(0.001)
        for number in (signal.SIGINT, signal.SIGTERM):  # while it is starting
            os.kill(process_ids(workers)[0], number)
        assert call.result() == 1
        for number in (signal.SIGINT, signal.SIGTERM):
            os.kill(process_ids(workers)[0], number)
        assert workers.submit(abs, -2).result() == 2
        assert workers.submit(mask).result() == mask() == set()


@pytest.mark.long
def test_a_training_run_continues_when_a_worker_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = itertools.count()
    submit = WorkerPool.submit

    def killing(self: WorkerPool, *call: Any) -> Future[Any]:
        pids = process_ids(self) if next(calls) == 8 else []
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
    few = {"train.decisions": 300, "train.validate_every": 300, "train.validation_episodes": 1}
    learner: Trainer = trainer(
        short_config(**few, **{"train.mode": "fast", "train.workers": 2}), tmp_path
    )
    listener = Notes()
    learner.listeners.append(listener)
    summary = learner.run()
    assert (summary["finished"], summary["decisions"]) == (True, 300)
    assert summary["lost_episodes"] == len(listener.notes) >= 1
    assert "a worker died and is replaced; its episode" in listener.notes[0]


@both
def test_nothing_is_imported_from_the_working_directory(count: int, hostile: Path) -> None:
    """In a process of its own, which starts the fork server there."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", PLACES.format(count=count)],
        **{"cwd": hostile, "capture_output": True, "text": True, "env": python_environment()},
    )
    assert (done.returncode, done.stdout) == (0, "[]\n"), done.stderr


def test_a_script_says_what_it_lacks(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "from flipperctl.rollout.pool import WorkerPool\n"
        "pool = WorkerPool(1, int, ())\n"
        "calls = [pool.submit(abs, -1) for _ in range(3)]\n"
        "print(calls[0].exception(), calls[1].exception(), calls[2].result())\n"
    )
    command = [sys.executable, "-P", str(script)]
    done = subprocess.run(command, capture_output=True, text=True, env=python_environment())
    assert done.returncode == 1
    assert 'needs: if __name__ == "__main__":' in done.stderr


@both
def test_a_worker_that_cannot_start_says_why(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> Any:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    text = r"^worker process 0 cannot start: ModuleNotFound.*x_y"
    with pytest.raises(FlipperctlError, match=text):
        asked(2, mask, first=("x_y",))  # the server runs afterwards
    monkeypatch.setattr(children, "ProcessHost", refuse)
    text = r"Too many open files; .*--jobs 1 .*train.mode=exact"
    with pytest.raises(FlipperctlError, match=text):
        asked(count, mask)
