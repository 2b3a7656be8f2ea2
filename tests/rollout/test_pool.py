"""The worker pool: it replaces a process that dies and runs the remaining calls."""

import os
import signal
import time
from pathlib import Path

import pytest

from flipperctl.errors import FlipperctlError
from flipperctl.rollout.pool import WorkerDiedError, WorkerPool
from flipperctl.training.trainer import Trainer
from tests.short import short_config, trainer


def initialize() -> None:
    """Prepare nothing."""


def double(number: int) -> int:
    return 2 * number


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fail() -> None:
    raise FlipperctlError("on purpose")


def test_a_dead_worker_is_replaced_and_runs_the_calls_after_it() -> None:
    workers = WorkerPool(2, initialize, ())
    try:
        functions = ((double, 1), (double, 5), (die,), (double, 6), (double, 2))  # by turns
        calls = [workers.submit(function, *arguments) for function, *arguments in functions]
        assert [workers.result(call) for call in calls[:2]] == [2, 10]
        with pytest.raises(WorkerDiedError, match="worker process 0 died"):
            workers.result(calls[2])
        assert [workers.result(call) for call in calls[3:]] == [12, 4]
    finally:
        workers.close()


def test_a_worker_that_always_dies_ends_the_pool_with_a_reason() -> None:
    workers = WorkerPool(2, initialize, ())
    try:
        for _ in range(2):
            with pytest.raises(WorkerDiedError):
                workers.result(workers.submit(die))
        with pytest.raises(FlipperctlError, match="3 times in a row"):
            workers.result(workers.submit(die))
    finally:
        workers.close()


def test_an_error_in_a_worker_is_raised_unchanged() -> None:
    workers = WorkerPool(2, initialize, ())
    try:
        with pytest.raises(FlipperctlError, match="on purpose"):
            workers.result(workers.submit(fail))
        assert workers.result(workers.submit(double, 3)) == 6
    finally:
        workers.close()


@pytest.mark.parametrize("count", [1, 2])  # spawned, and forked from a server
def test_what_stops_a_whole_group_of_processes_leaves_the_workers_at_work(count: int) -> None:
    """Ctrl-C and a scheduler's SIGTERM reach every process; the learner stops its workers."""
    workers = WorkerPool(count, initialize, ())
    try:
        call = workers.submit(double, 1)
        for number in (signal.SIGINT, signal.SIGTERM):  # while it is starting
            os.kill(workers.process_ids()[0], number)
        assert workers.result(call) == 2
        for number in (signal.SIGINT, signal.SIGTERM):
            os.kill(workers.process_ids()[0], number)
        assert workers.result(workers.submit(double, 2)) == 4
        assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == set()
    finally:
        workers.close()


class Killer:
    """A listener that kills a worker after the fifth episode and collects the notes."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.episodes = 0

    def episode(self, row: dict) -> None:
        self.episodes += 1
        if self.episodes == 5:
            os.kill(children()[0], signal.SIGKILL)
            time.sleep(0.2)

    def validation(self, row: dict) -> None:
        pass

    def note(self, text: str) -> None:
        self.notes.append(text)

    def close(self) -> None:
        pass


_pools: list[WorkerPool] = []


def children() -> list[int]:
    return _pools[-1].process_ids()


def test_a_training_run_continues_when_a_worker_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    create = WorkerPool.__init__

    def remembered(self: WorkerPool, *arguments: object) -> None:
        create(self, *arguments)
        _pools.append(self)

    monkeypatch.setattr(WorkerPool, "__init__", remembered)
    learner: Trainer = trainer(short_config(**{"train.mode": "fast", "train.workers": 2}), tmp_path)
    killer = Killer()
    learner.listeners.append(killer)
    summary = learner.run()
    assert summary["finished"] is True
    assert summary["decisions"] == 600
    assert summary["lost_episodes"] == len(killer.notes) >= 1
    assert "a worker died and is replaced; its episode" in killer.notes[0]
