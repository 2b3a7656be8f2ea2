"""Runs that are stopped in the middle of a validation."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flipperctl import checkpoint
from flipperctl.training.trainer import Trainer
from tests.short import short_config, trainer

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("mode", ["exact", "fast"])
def test_a_run_stopped_in_a_validation_begins_with_it_again(tmp_path: Path, mode: str) -> None:
    config = short_config(**{"train.mode": mode, "train.workers": 2, "train.decisions": 400})
    trainer(config, tmp_path / "whole").run()

    first = trainer(config, tmp_path / "parts")
    summary = first.run(stop=stop_in_validation(first))
    assert summary["finished"] is False
    assert first.validator.last is None
    stopped = checkpoint.read(tmp_path / "parts" / checkpoint.LAST)
    assert stopped.document.state is not None
    assert stopped.document.state.decision >= 300
    second = trainer(stopped.config(), tmp_path / "parts")
    second.restore(stopped)
    assert second.run()["finished"] is True
    for name in (checkpoint.BEST, checkpoint.LAST):
        parts, whole = ((tmp_path / folder / name).read_bytes() for folder in ("parts", "whole"))
        assert parts == whole, name


def test_a_run_stopped_in_its_last_validation_is_not_finished(tmp_path: Path) -> None:
    config = short_config(**{"train.decisions": 200, "train.validate_every": 1000})
    first = trainer(config, tmp_path)
    assert first.run(stop=lambda: first.progress.decision >= 200)["finished"] is False
    stopped = checkpoint.read(tmp_path / checkpoint.LAST)
    second = trainer(stopped.config(), tmp_path)
    second.restore(stopped)
    summary = second.run()
    assert (summary["finished"], summary["last"]["decision"]) == (True, 200)


def stop_in_validation(run: Trainer) -> Callable[[], bool]:
    """Return a ``stop`` that is true once the first validation has begun."""
    validate = run.validator.validate
    within = False

    def watched(*arguments: Any) -> Any:
        nonlocal within
        within = True
        return validate(*arguments)

    run.validator.validate = watched
    return lambda: within
