"""Training: it learns, it resumes bit for bit, and its records are complete."""

import csv
import json
import math
import multiprocessing
from pathlib import Path
from typing import Any, cast

import pytest
import torch

from flipperctl import checkpoint
from flipperctl.api import RewardTerm, Transition, registry, reward
from flipperctl.checkpoint.document import Validation
from flipperctl.config import TrainConfig, resolver, with_overrides
from flipperctl.errors import NonFiniteError, WriteError
from flipperctl.training.listeners import MetricsCsv, read_rows
from flipperctl.training.validation import Validator
from tests.short import short_config, trainer

pytestmark = pytest.mark.slow


def test_a_short_training_learns_to_climb_steps(tmp_path: Path) -> None:
    learner = trainer(
        short_config(**{"train.decisions": 3000, "agent.epsilon_decisions": 2000}), tmp_path
    )
    best = learner.run()["best"]
    # An untrained network hardly ever reaches the finish (first validation); a trained one mostly.
    assert best is not None
    assert best["success_rate"] >= 2 / 3
    assert best["decision"] > 300


def test_updates_wait_for_the_first_complete_transition(tmp_path: Path) -> None:
    # The first transition of 10 steps is complete after 10 decisions, of which each has an update.
    eager = {"agent.learning_starts": 1, "agent.update_every": 1, "agent.updates_together": 1}
    config = short_config(**eager, **{"agent.n_step": 10, "train.decisions": 30})
    learner = trainer(config, tmp_path)
    learner.run()
    assert learner.progress.updates == 21


def test_a_resumed_run_equals_the_uninterrupted_one_bit_for_bit(
    tmp_path: Path, short_run: Path
) -> None:
    first = trainer(short_config(), tmp_path)
    first.run(stop=lambda: first.progress.decision >= 250)
    stopped = checkpoint.read(tmp_path / checkpoint.LAST)
    assert 250 <= stopped.document.state.decision < 600

    second = trainer(stopped.config(), tmp_path)
    second.restore(stopped)
    second.run()

    resumed = checkpoint.read(tmp_path / checkpoint.LAST)
    whole = checkpoint.read(short_run / checkpoint.LAST)
    assert resumed.tensors.keys() == whole.tensors.keys()
    for name, tensor in whole.tensors.items():
        assert torch.equal(resumed.tensors[name], tensor), name
    ours, theirs = resumed.document.state, whole.document.state
    assert ours == theirs
    for name in (checkpoint.BEST, checkpoint.LAST):  # as sha256sum sees it
        assert (tmp_path / name).read_bytes() == (short_run / name).read_bytes(), name


@pytest.mark.parametrize("workers", [2, pytest.param(1, marks=pytest.mark.long)])
def test_a_fast_run_is_repeatable_and_resumes_bit_for_bit_with_its_requests(
    workers: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The server of the two forks the lone worker, which would import torch for each training.
    server = multiprocessing.get_context("forkserver")
    monkeypatch.setattr(multiprocessing, "get_context", lambda method: server)
    config = short_config(
        **{
            "train.mode": "fast",
            "train.workers": workers,
            "agent.risk": workers == 1,
            # A request holds the difficulty of its episode.
            "terrain": {"name": "curriculum", "start": 0.5, "up": 0.2, "down": 0.1},
        }
    )
    trainer(config, tmp_path / "whole").run()
    whole = checkpoint.read(tmp_path / "whole" / checkpoint.LAST)

    first = trainer(config, tmp_path / "parts")
    first.run(stop=lambda: first.progress.decision >= 250)
    stopped = checkpoint.read(tmp_path / "parts" / checkpoint.LAST)
    assert len(stopped.document.state.orders) == 2 * workers - 1
    second = trainer(stopped.config(), tmp_path / "parts")
    second.restore(stopped)
    second.run()

    resumed = checkpoint.read(tmp_path / "parts" / checkpoint.LAST)
    assert resumed.tensors.keys() == whole.tensors.keys()
    for name, tensor in whole.tensors.items():
        assert torch.equal(resumed.tensors[name], tensor), name
    assert resumed.document.state == whole.document.state
    for name in (checkpoint.BEST, checkpoint.LAST):  # as sha256sum sees it
        parts, at_once = tmp_path / "parts" / name, tmp_path / "whole" / name
        assert parts.read_bytes() == at_once.read_bytes(), name


def test_equal_seeds_give_equal_runs_and_others_do_not(tmp_path: Path, short_run: Path) -> None:
    whole = checkpoint.read(short_run / checkpoint.LAST).part("online")
    trainer(short_config(seed=8), tmp_path / "other").run()
    other = checkpoint.read(tmp_path / "other" / checkpoint.LAST).part("online")
    assert any(not torch.equal(whole[name], other[name]) for name in whole)


def test_the_budget_is_met_exactly(short_run: Path) -> None:
    summary = json.loads((short_run / "summary.json").read_text())
    assert summary["finished"] is True
    assert summary["decisions"] == 600
    assert summary["last"]["decision"] == 600


def test_metrics_have_a_row_per_episode_and_drop_rows_after_a_resumed_checkpoint(
    tmp_path: Path,
) -> None:
    path = tmp_path / "metrics.csv"
    first = trainer(short_config(), tmp_path)
    first.listeners.append(MetricsCsv(path, ["flipper", "pitch", "end"]))
    first.run()
    rows = read_rows(path)
    episodes = [row for row in rows if row["kind"] == "episode"]
    assert [int(row["episode"]) for row in episodes] == list(range(1, first.progress.episode + 1))
    parts = [
        sum(float(row[f"reward_{t}"]) for t in ("flipper", "pitch", "end")) for row in episodes
    ]
    assert parts == pytest.approx([float(row["return"]) for row in episodes])

    MetricsCsv(path, ["flipper", "pitch", "end"], resume_at=300).close()
    kept = read_rows(path)
    assert kept == [row for row in rows if int(row["decision"]) <= 300]
    assert 0 < len(kept) < len(rows)
    with path.open() as file:
        assert next(csv.reader(file))[0] == "kind"


def validation(success: float, at_decisions: float, at_100_hz: float | None) -> Validation:
    return Validation(
        decision=1,
        success_rate=success,
        t_cost=10.0,
        pitch_variation=at_decisions,
        pitch_variation_100hz=at_100_hz,
    )


def test_best_is_chosen_by_success_then_by_pitch_variation_at_100_hz() -> None:
    validator = Validator.__new__(Validator)
    rocking, calm = validation(1.0, 1.0, 1.5), validation(1.0, 1.2, 1.3)
    validator.best_by, validator.history = (
        "pitch_variation_100hz",
        [validation(0.9, 0.1, 0.2), rocking, calm],
    )
    assert validator.best == calm


def test_the_best_policy_by_return_is_the_one_that_its_rewards_pay_most(tmp_path: Path) -> None:
    validator = trainer(short_config(**{"train.best_by": "return"}), tmp_path).validator
    calm, paid = validation(1.0, 1.0, 1.0), validation(0.9, 2.0, 2.0)
    validator.history[:] = [
        calm.model_copy(update={"mean_return": 1.0}),
        paid.model_copy(update={"mean_return": 2.0}),
    ]
    assert validator.best is validator.history[1]


def test_the_last_policy_may_be_the_best(tmp_path: Path) -> None:
    validator = trainer(short_config(**{"train.best_by": "last"}), tmp_path).validator
    early, late = validation(1.0, 1.0, 1.0), validation(0.9, 2.0, 2.0)
    validator.history[:] = [
        early.model_copy(update={"decision": 300}),
        late.model_copy(update={"decision": 600}),
    ]
    assert validator.best is validator.history[1]


def test_a_validation_s_return_counts_every_episode_and_no_shaping(tmp_path: Path) -> None:
    shaped = {"rewards": {"shaped_progress": {"name": "shaped_progress"}}}  # beside the paper's
    run = trainer(short_config(**{"train.validation_episodes": 6, **shaped}), tmp_path)
    rows = list[dict[str, Any]]()

    class Kept:
        def evaluate(self, weights: object, seeds: list[int], play: Any) -> list[dict[str, Any]]:
            rows.extend(play(seed) for seed in seeds)
            return rows

    found = run.validator.validate(cast(Any, Kept()), 0)
    assert found is not None
    assert {row["outcome"] for row in rows} - {"reached"}  # untrained
    paid = [row["reward_flipper"] + row["reward_pitch"] + row["reward_end"] for row in rows]
    assert found.mean_return == pytest.approx(sum(paid) / len(rows))
    assert found.mean_return != pytest.approx(sum(row["return"] for row in rows) / len(rows))


def test_a_reward_that_is_not_finite_stops_the_run_and_is_named(tmp_path: Path) -> None:
    @reward("sometimes_nan")
    class SometimesNan(RewardTerm):
        """Return NaN when an episode ends."""

        def __call__(self, t: Transition) -> float:
            return 0.0 if t.outcome is None else math.nan

    try:
        rewards = {**plugins_of(short_config()), "odd": {"name": "sometimes_nan"}}
        config = with_overrides(short_config(), {"rewards": rewards})
        with pytest.raises(NonFiniteError, match=r"rewards\.odd.*SometimesNan.*nan"):
            trainer(config, tmp_path).run()
    finally:
        del registry["reward", "sometimes_nan"]


def plugins_of(config: TrainConfig) -> dict[str, dict[str, object]]:
    return {name: resolver.to_dict(term) for name, term in config.rewards.items()}


def test_a_failing_write_keeps_the_checkpoint_before(
    short_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "last.safetensors"
    saved = checkpoint.read(short_run / checkpoint.LAST)
    checkpoint.write(target, saved.document, saved.tensors)
    before = target.read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(WriteError, match=r"No space left on device.*the old file is kept"):
        checkpoint.write(target, saved.document, {})
    assert target.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["last.safetensors"]
    with pytest.raises(WriteError, match=r"No space left on device\)$"):
        checkpoint.write(tmp_path / "new.safetensors", saved.document, {})  # there is no old one
