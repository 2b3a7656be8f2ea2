"""Worker processes: they are replaced when they die, and the rest of their work is done."""

import os
import signal
import time
from pathlib import Path

import pytest

from flipperctl.errors import FlipperctlError
from flipperctl.rollout.processes import WorkerDiedError, Workers
from flipperctl.training.trainer import Trainer
from tests.short import short_config, trainer


def begin() -> None:
    """Nothing to prepare."""


def double(number: int) -> int:
    return 2 * number


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fail() -> None:
    raise FlipperctlError("on purpose")


def test_a_dead_worker_is_replaced_and_does_what_waited_behind() -> None:
    workers = Workers(1, begin, ())
    try:
        jobs = [workers.submit(double, 1), workers.submit(die), workers.submit(double, 2)]
        assert workers.result(jobs[0]) == 2
        with pytest.raises(WorkerDiedError, match="worker process 0 died"):
            workers.result(jobs[1])
        assert workers.result(jobs[2]) == 4
    finally:
        workers.close()


def test_a_worker_that_always_dies_is_given_up_with_a_reason() -> None:
    workers = Workers(1, begin, ())
    try:
        for _ in range(2):
            with pytest.raises(WorkerDiedError):
                workers.result(workers.submit(die))
        with pytest.raises(FlipperctlError, match="3 times in a row"):
            workers.result(workers.submit(die))
    finally:
        workers.close()


def test_an_error_in_a_worker_arrives_as_it_is() -> None:
    workers = Workers(2, begin, ())
    try:
        with pytest.raises(FlipperctlError, match="on purpose"):
            workers.result(workers.submit(fail))
        assert workers.result(workers.submit(double, 3)) == 6
    finally:
        workers.close()


class Killer:
    """A listener that kills a worker behind the fifth episode, and hears what is said of it."""

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


_workers: list[Workers] = []


def children() -> list[int]:
    return _workers[-1].processes()


def test_a_training_run_goes_on_when_a_worker_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    create = Workers.__init__

    def remembered(self: Workers, *arguments: object) -> None:
        create(self, *arguments)
        _workers.append(self)

    monkeypatch.setattr(Workers, "__init__", remembered)
    learner: Trainer = trainer(short_config(**{"train.mode": "fast"}), tmp_path)
    killer = Killer()
    learner.listeners.append(killer)
    summary = learner.run()
    assert summary["finished"] is True
    assert summary["decisions"] == 600
    assert summary["lost_episodes"] == len(killer.notes) >= 1
    assert "a worker died and is replaced; its episode" in killer.notes[0]
