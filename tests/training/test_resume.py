"""A stopped run resumes bit for bit, whoever plays, whatever it learns with."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flipperctl import checkpoint
from flipperctl.env.privileged import SIZE
from flipperctl.errors import CheckpointError
from flipperctl.text.files import read_csv
from flipperctl.training.listeners import MetricsCsv
from flipperctl.training.run import resume
from flipperctl.training.trainer import Trainer
from tests.short import few, short_config, trainer
from tests.training.conftest import SETUPS, require_resumes, require_same_end, setup

pytestmark = pytest.mark.slow

Runs = Callable[[str], Path]
TIME_LEFT = 38
"""Column of the share of the time limit that is left."""


@pytest.mark.parametrize("name", sorted(SETUPS.keys() - {"conv", "quantile"}))
def test_a_resumed_run_equals_the_uninterrupted_one(name: str, runs: Runs, tmp_path: Path) -> None:
    stopped = require_resumes(setup(name), runs(name), tmp_path, 70)
    assert stopped.document.state is not None
    # Of the four requests that keep two workers busy, one has ended; they are saved and repeated.
    assert len(stopped.document.state.orders) == (3 if name == "fast" else 0)


@pytest.mark.long
@pytest.mark.parametrize("name", ["stacked", "noisy", "taught"])
def test_a_run_in_workers_resumes_too(name: str, tmp_path: Path) -> None:
    config = setup(name, **{"train.mode": "fast", "train.workers": 2})
    trainer(config, tmp_path / "whole").run()
    require_resumes(config, tmp_path / "whole", tmp_path / "parts", 70)


def test_the_settings_of_the_precise_experiment_reach_the_replay(runs: Runs) -> None:
    tensors = checkpoint.read(runs("stacked") / checkpoint.LAST).tensors
    # Sums of three rewards that were cut bootstrap after one or two decisions.
    discounts = {round(float(d), 3) for d in tensors["replay.discount"].unique()}
    assert {0.99, 0.98, 0.97} <= discounts
    # Every decision has the privileged states before and after; the share of the time falls.
    before, after = tensors["replay.privileged"], tensors["replay.next_privileged"]
    assert before.shape == after.shape == (len(tensors["replay.discount"]), SIZE)
    assert bool((after[:, TIME_LEFT] < before[:, TIME_LEFT]).all())
    assert any(name.startswith("baselines.target.") for name in tensors)
    # Errors were remembered; transitions that no update has met have the largest.
    assert len(tensors["replay.priority"].unique()) > 50
    # With a teacher none is preferred.
    assert "replay.priority" not in checkpoint.read(runs("taught") / checkpoint.LAST).tensors


@pytest.mark.parametrize("mode", ["exact", pytest.param("fast", marks=pytest.mark.long)])
def test_a_run_stopped_in_a_validation_begins_with_it_again(tmp_path: Path, mode: str) -> None:
    less = {"train.decisions": 120, "train.validate_every": 60, "train.validation_episodes": 1}
    config = few(**{"train.mode": mode, "train.workers": 2, **less})
    trainer(config, tmp_path / "whole").run()
    first = trainer(config, tmp_path / "parts")
    assert first.run(stop=stop_in_validation(first))["finished"] is False
    assert first.validator.last is None
    require_same_end(tmp_path / "whole", tmp_path / "parts")


def test_a_run_goes_on_over_the_recorded_ground_on_which_it_began(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file, run = tmp_path / "yard.csv", tmp_path / "run"
    recorded = "x,z\n0,0\n3,0\n3,0.2\n6,0.2\n"
    file.write_text(recorded)
    ground = {"name": "mirror", "terrain": {"name": "profile_file", "path": "yard.csv"}}
    less = {"train.decisions": 30, "train.validation_episodes": 1, "train.regret_episodes": 0}
    config = short_config(**{"terrain": ground, **less})
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


def test_difficulty_grows_with_success_and_is_kept_when_a_run_is_resumed(tmp_path: Path) -> None:
    flat = {"name": "flat", "length": 0.1}
    ground = {"name": "curriculum", "easy": flat, "hard": {**flat, "length": 1.1}, "up": 0.25}
    short = {"episode.run_up": 0.8, "episode.run_out": 0.0, "train.decisions": 100}
    config = few(**{"terrain": ground, **short, "train.validate_every": 1000})
    whole = trainer(config, tmp_path)
    whole.listeners.append(MetricsCsv(tmp_path / "metrics.csv", []))
    whole.run(stop=lambda: whole.progress.difficulty >= 0.25)
    expected = 0.0
    rows = read_csv(tmp_path / "metrics.csv")
    for row in (row for row in rows if row["kind"] == "episode"):
        assert (row["terrain"], float(row["difficulty"])) == ("flat", pytest.approx(expected))
        expected = config.terrain.next_difficulty(expected, row["outcome"] == "reached")
    again = trainer(config, tmp_path)
    again.restore(checkpoint.read(tmp_path / checkpoint.LAST))
    assert again.progress.difficulty == expected > 0
