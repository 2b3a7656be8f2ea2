"""Listeners are closed when a training, its start, or one of them fails."""

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from flipperctl.config import TrainConfig, with_overrides
from flipperctl.errors import WriteError
from flipperctl.training import run as training
from flipperctl.training.trainer import Trainer, closer, open_all
from tests.cli.call import RUN


class Faulty:
    """A listener that fails in the methods that are named, and remembers that it was closed."""

    def __init__(self, *methods: str) -> None:
        self.methods = methods
        self.closed = 0

    def _fail(self, method: str) -> None:
        if method in self.methods:
            raise WriteError(f"{method} failed")

    def episode(self, row: Mapping[str, Any]) -> None:
        self._fail("episode")

    def validation(self, row: Mapping[str, Any]) -> None:
        self._fail("validation")

    def note(self, text: str) -> None:
        self._fail("note")

    def close(self) -> None:
        self.closed += 1
        self._fail("close")


@pytest.fixture
def trainer(tmp_path: Path) -> Trainer:
    short = {**RUN, "train.mode": "exact", "episode.run_out": 0.2}
    config = with_overrides(TrainConfig(terrain="flat", network="mlp"), short)
    (tmp_path / "checkpoints").mkdir()
    return Trainer(config, tmp_path)


@pytest.mark.parametrize("method", ["episode", "validation", "close"])
def test_all_listeners_are_closed_though_one_fails(method: str, trainer: Trainer) -> None:
    listeners = [Faulty(), Faulty(method), Faulty()]
    trainer.listeners += listeners
    with pytest.raises(WriteError, match=f"{method} failed"):
        trainer.run()
    assert [listener.closed for listener in listeners] == [1, 1, 1]


@pytest.mark.parametrize("step", ["Trainer.save", "add_recorded"])
def test_listeners_are_closed_when_a_run_does_not_start(
    step: str, trainer: Trainer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*given: object) -> None:
        raise WriteError("no space")

    listener = Faulty("close")
    trainer.listeners.append(listener)
    monkeypatch.setattr(f"flipperctl.training.trainer.{step}", fail)
    with pytest.raises(WriteError, match="no space"):  # not that of the closing
        trainer.run()
    assert listener.closed == 1


def test_a_listener_that_cannot_be_made_closes_those_before(
    trainer: Trainer, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[training.MetricsCsv] = []

    class Kept(training.MetricsCsv):
        def __init__(self, *given: Any) -> None:
            super().__init__(*given)
            made.append(self)

    def fail(*given: object) -> None:
        raise WriteError("no space")

    monkeypatch.setattr(training, "MetricsCsv", Kept)
    monkeypatch.setattr(training, "openers", lambda *given: [fail])
    with pytest.raises(WriteError, match="no space"):
        training._train(trainer, None, training.Reports(), lambda: False)
    assert made[0]._file.closed


def test_the_newest_is_closed_first_and_the_first_error_is_raised() -> None:
    order: list[int] = []

    class Numbered:
        def __init__(self, number: int) -> None:
            self.number = number

        def close(self) -> None:
            order.append(self.number)
            if self.number in (1, 2):
                raise WriteError(str(self.number))

    opened = open_all([lambda: Numbered(0), lambda: Numbered(1)])
    stack = ExitStack()
    for one in (*opened, Numbered(2), Numbered(3)):
        stack.push(closer(one))
    with pytest.raises(WriteError, match="2"):
        stack.close()
    assert order == [3, 2, 1, 0]
