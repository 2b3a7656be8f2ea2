"""A training by Stable-Baselines3 is a run like any other, and its policy that of the library."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from flipperctl import checkpoint
from flipperctl.agent.risk import weights_of
from flipperctl.api import ACTIONS
from flipperctl.config import TrainConfig, with_overrides
from flipperctl.errors import CheckpointError
from flipperctl.evaluation.play import EpisodeDigest
from flipperctl.export.policy import export
from flipperctl.learners.sb3_run import Sb3Learning
from flipperctl.policies.acting import TrainedPolicy
from flipperctl.policies.source import ExportedPolicy
from flipperctl.policies.trained import policy_module
from flipperctl.rollout.episode import decisions
from flipperctl.runtime import OnnxPolicy
from flipperctl.training.trainer import Trainer
from tests.rollout.notes import Notes
from tests.short import few

pytestmark = pytest.mark.slow

SMALL = {"learning_starts": 50, "batch_size": 32}
METHODS: dict[tuple[str, str], dict[str, Any]] = {
    ("dqn", "turns"): SMALL,
    ("ppo", "turns"): {"n_steps": 64, "batch_size": 32, "n_epochs": 2},
    ("ppo", "rates"): {"n_steps": 64, "batch_size": 32, "learning_rate": [1e-3, 0.0]},
    ("a2c", "rates"): {},
    ("sac", "rates"): {**SMALL, "policy_kwargs": {"n_critics": 1}},
    ("td3", "rates"): {**SMALL, "train_freq": [1, "episode"]},
    ("ddpg", "rates"): {**SMALL, "buffer_size": 100},
}


def config_of(algorithm: str, actions: str, **more: object) -> TrainConfig:
    agent = {"name": "sb3", "algorithm": algorithm, "settings": METHODS[algorithm, actions]}
    network = {"name": "mlp", "hidden": [24, 16]}
    own = {"agent": agent, "actions": actions, "network": network}
    return few(**{**own, "train.decisions": 150, **more})


def train(config: TrainConfig, folder: Path, stop: int | None = None) -> Trainer:
    (folder / checkpoint.BEST.parent).mkdir(parents=True, exist_ok=True)
    made = Trainer(config, folder)
    made.run(stop=lambda: stop is not None and made.progress.decision >= stop)
    return made


def learning_of(made: Trainer) -> Sb3Learning:
    assert isinstance(made.learning, Sb3Learning)
    return made.learning


def observations(count: int) -> Any:
    rng = np.random.default_rng(0)
    return rng.normal(0.0, 0.2, (count, 33)).astype(np.float32)


QUICK = ("dqn", "turns"), ("ppo", "rates"), ("sac", "rates")
"""Values, a stochastic and a deterministic actor; the others share their code."""


@pytest.mark.parametrize(
    ("algorithm", "actions"),
    [pytest.param(*pair, marks=[pytest.mark.long] * (pair not in QUICK)) for pair in METHODS],
)
def test_the_checkpoint_acts_as_the_library_does(
    algorithm: str, actions: str, tmp_path: Path
) -> None:
    trained = train(config_of(algorithm, actions), tmp_path)
    saved = checkpoint.read(tmp_path / checkpoint.LAST)
    module, seen = policy_module(saved), observations(200)
    theirs, _ = learning_of(trained).model.predict(seen, deterministic=True)
    with torch.inference_mode():
        outputs = module(torch.from_numpy(seen)).numpy()
    if actions == "rates":
        assert np.abs(outputs - theirs).max() < 1e-5
        assert outputs.std() > 1e-3
    else:
        assert (outputs.argmax(axis=1) == theirs).all()
    assert saved.document.actions.steps == (() if actions == "rates" else ACTIONS)


@pytest.mark.parametrize("algorithm", ["sac", "ddpg"])
def test_a_stopped_run_goes_on_with_weights_moments_and_replay(
    algorithm: str, tmp_path: Path
) -> None:
    config = config_of(algorithm, "rates")
    stopped = train(config, tmp_path, stop=120)
    saved = checkpoint.read(tmp_path / checkpoint.LAST)
    assert not any(name.endswith(".pkl") for name in map(str, tmp_path.rglob("*")))
    resumed = Trainer(config, tmp_path)
    resumed.restore(saved)
    assert resumed.progress.decision == stopped.progress.decision < 150
    first, second = learning_of(stopped), learning_of(resumed)
    before, after = first._held(), second._held()
    assert before.keys() == after.keys()
    assert all(torch.equal(before[name], after[name]) for name in before)
    kept, found = first._replay(), second._replay()
    assert kept is not None
    assert found is not None
    assert len(found["reward"]) == min(
        stopped.progress.decision, 100 if algorithm == "ddpg" else 150
    )
    assert all(torch.equal(kept[name], found[name]) for name in kept)
    assert resumed.run()["decisions"] == 150
    more = with_overrides(config, {"network.hidden": [16, 16]})
    with pytest.raises(CheckpointError, match="its state is not valid"):
        Trainer(more, tmp_path).restore(saved)


def test_an_exported_file_of_rates_drives_the_same_episode(tmp_path: Path) -> None:
    config = config_of("sac", "rates")
    trained = train(config, tmp_path)
    file = tmp_path / "rates.onnx"
    saved = checkpoint.read(tmp_path / checkpoint.BEST)
    assert export(saved, file)["action_agreement"] == 1.0
    digests = []
    for policy in (TrainedPolicy(policy_module(saved), kind="rates"), ExportedPolicy(file)):
        digest = EpisodeDigest()
        for decision in decisions(trained.env, policy, 5):
            assert decision.rates is not None
            digest.add(decision)
        digests.append(digest.hexdigest())
    assert digests[0] == digests[1]
    robot = OnnxPolicy(file)
    step = config.robot.angle_step
    assert robot.interface.actions.tolist() == [[step, 0], [0, step]]
    turned = robot.next_targets((0.1, -0.1), (0.1, -0.1), (0.5, -1.0))
    assert turned.tolist() == pytest.approx([0.1 + 0.5 * step, -0.1 - step])
    rates = robot.act(observations(1)[0])
    assert isinstance(rates, tuple)
    assert max(map(abs, rates)) <= 1


def learnt(algorithm: str, folder: Path, **settings: object) -> tuple[Trainer, list[str]]:
    """Train, or resume the run in ``folder``; return its trainer and notes."""
    config = config_of(algorithm, "turns", **settings)
    (folder / checkpoint.BEST.parent).mkdir(parents=True, exist_ok=True)
    notes = Notes()
    trainer = Trainer(config, folder, [notes])
    if (folder / checkpoint.LAST).is_file():
        trainer.restore(checkpoint.read(folder / checkpoint.LAST))
    trainer.run()
    return trainer, notes.notes


def test_the_rest_of_a_rollout_is_learnt_from(tmp_path: Path) -> None:
    """Below one rollout, at the end of a run, and in each short run that resumes it."""
    weights, updates = [], []
    for budget, words in (
        (40, "40: the policy learns"),
        (144, ""),
        (180, "36: "),
        (181, "1: the policy stays"),
    ):
        trainer, notes = learnt("ppo", tmp_path, **{"train.decisions": budget})
        assert trainer.progress.decision == budget
        assert [words in note for note in notes] == [True] * bool(words)
        weights.append(weights_of(trainer.learning.policy))
        updates.append(learning_of(trainer).model._n_updates // 2)
    assert updates == [1, 2, 1, 0]  # 104 decisions are a rollout of 64 and a rest of 40
    same = [
        all((a == b).all() for a, b in zip(one.values(), other.values(), strict=True))
        for one, other in pairwise(weights)
    ]
    assert same == [False, False, True]


def test_a_single_decision_joins_the_rollout_before(tmp_path: Path) -> None:
    trainer, notes = learnt("ppo", tmp_path, **{"train.decisions": 129})
    assert not notes
    assert learning_of(trainer).model.rollout_buffer.buffer_size == 65


def test_an_off_policy_budget_is_stated_until_it_learns(tmp_path: Path) -> None:
    for budget, count in ((30, 1), (45, 1), (80, 0)):
        _, notes = learnt("dqn", tmp_path, **{"train.decisions": budget})
        assert len(notes) == count
        assert all("agent.settings.learning_starts=50" in note for note in notes)
