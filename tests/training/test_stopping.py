"""Runs that are stopped in the middle of a validation."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flipperctl import checkpoint
from flipperctl.errors import CheckpointError
from flipperctl.training.run import resume
from flipperctl.training.trainer import Trainer
from tests.short import short_config, trainer

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("mode", ["exact", pytest.param("fast", marks=pytest.mark.long)])
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


def test_a_run_goes_on_over_the_recorded_ground_on_which_it_began(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file, run = tmp_path / "yard.csv", tmp_path / "run"
    recorded = "x,z\n0,0\n3,0\n3,0.2\n6,0.2\n"
    file.write_text(recorded)
    ground = {"name": "mirror", "terrain": {"name": "profile_file", "path": "yard.csv"}}
    few = {"train.decisions": 30, "train.validation_episodes": 1, "train.regret_episodes": 0}
    config = short_config(**{"terrain": ground, **few})
    assert trainer(config, run).run(stop=lambda: True)["finished"] is False
    before = (run / checkpoint.LAST).read_bytes()
    file.write_text(recorded.replace("0.2", "0.3"))
    with pytest.raises(CheckpointError, match=r"^yard\.csv has changed since the run began"):
        resume(run, {})
    assert (run / checkpoint.LAST).read_bytes() == before
    file.write_text(recorded)
    assert resume(run, {}).summary["decisions"] == 30


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
