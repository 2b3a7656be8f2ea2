"""Trainings by the policy gradient: in both modes, resumed, and with what they do not go with."""

from pathlib import Path

import numpy as np
import pytest
import torch

from flipperctl import checkpoint
from flipperctl.agent.policy_gradient import PolicyGradient
from flipperctl.agent.replay import Replay
from flipperctl.config import TrainConfig, with_overrides
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.policies.values import learned_value
from flipperctl.training.saving import Progress
from flipperctl.training.trainer import EpisodeUpdates
from tests.short import short_config, trainer

pytestmark = pytest.mark.slow

SETTINGS = {
    "agent.learner": "policy_gradient",
    "agent.n_step": 1,
    "agent.risk": True,
    "agent.policy_gradient.decisions": 100,
    "agent.policy_gradient.warm_up": 1,
    "agent.policy_gradient.anchor": 0.01,
}


def config(**more: object) -> TrainConfig:
    return short_config(**{**SETTINGS, **more})


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("policy_gradient")
    trainer(config(), folder).run()
    return folder


def test_each_decision_is_drawn_by_probabilities_and_used_once(run: Path) -> None:
    last = checkpoint.read(run / checkpoint.LAST)
    labels = last.part("replay")["label"].numpy()
    assert labels.sum(axis=1) == pytest.approx(np.ones(len(labels)), abs=1e-5)
    rounds, learnt, policy_steps, value_steps, _ = last.part("counts")["all"].tolist()
    assert 3 <= rounds <= 5
    assert 100 * rounds <= learnt <= 600
    assert policy_steps > 0
    assert value_steps > policy_steps


def test_the_policy_moves_from_its_start_after_the_warm_up(run: Path) -> None:
    last = checkpoint.read(run / checkpoint.LAST)
    anchor, online = last.part("anchor"), last.part("online")
    assert anchor.keys() == online.keys()
    assert any(not torch.equal(anchor[name], online[name]) for name in anchor)


def test_the_part_of_an_episode_that_the_budget_cut_is_not_learnt(run: Path) -> None:
    last = checkpoint.read(run / checkpoint.LAST)
    state, replay = last.document.state, last.part("replay")
    assert state is not None
    assert len(replay["discount"]) < state.decision == 600  # it cuts one
    ends = (replay["discount"] == 0).sum()
    assert replay["discount"][-1] == 0
    assert ends == state.episode


def test_a_round_longer_than_the_replay_is_refused(tmp_path: Path) -> None:
    agent = trainer(config(), tmp_path).agent
    assert isinstance(agent, PolicyGradient)
    replay, row = Replay(4, size=2, n_step=1, gamma=0.5), np.zeros(2, np.float32)
    for step in range(6):
        replay.add(row, 0, 0.0, row, over=step == 5, bootstrap=False)
    updates = EpisodeUpdates(config(), agent, replay, Progress(1.0), np.random.default_rng(0))
    with pytest.raises(ConfigError, match=r"agent\.replay_size: 4 decisions .* than the 6 of"):
        updates.after_episode()


def test_a_resumed_run_equals_the_uninterrupted_one(run: Path, tmp_path: Path) -> None:
    stopped = trainer(config(), tmp_path)
    stopped.run(lambda: stopped.progress.decision >= 250)
    assert stopped.progress.decision < 600
    again = trainer(config(), tmp_path)
    again.restore(checkpoint.read(tmp_path / checkpoint.LAST))
    again.run()
    whole, resumed = (checkpoint.read(f / checkpoint.LAST) for f in (run, tmp_path))
    assert resumed.tensors.keys() == whole.tensors.keys()
    for name, tensor in whole.tensors.items():
        assert torch.equal(resumed.tensors[name], tensor), name


def test_its_draws_become_sharper_towards_the_end(tmp_path: Path) -> None:
    trained = trainer(config(**{"agent.policy_gradient.temperature_end": 0.001}), tmp_path)
    trained.run()
    labels = checkpoint.read(tmp_path / checkpoint.LAST).part("replay")["label"].numpy()
    assert labels[-60:].max(axis=1).mean() > labels[:60].max(axis=1).mean() + 0.2


def test_workers_draw_too(tmp_path: Path) -> None:
    made = trainer(config(**{"train.mode": "fast", "train.decisions": 300}), tmp_path)
    made.run()
    labels = made.replay.arrays["label"][: len(made.replay)]
    assert labels.sum(axis=1) == pytest.approx(np.ones(len(labels)), abs=1e-5)
    assert labels.max() < 1


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"agent.n_step": 3}, "agent.n_step: 3 does not go with agent.learner=policy_gradient"),
        ({"agent.bootstrap_outcomes": ["timeout"]}, "agent.bootstrap_outcomes: "),
        ({"agent.replay_size": 199, "agent.policy_gradient.decisions": 100}, "200 .* or more is"),
        ({"teacher": {"controller": {"name": "okada"}}}, "set teacher=none"),
        ({"agent.policy_gradient.start_values": True}, "start_values: true needs a run"),
    ],
)
def test_settings_that_do_not_go_with_it_are_refused(changes: dict[str, object], text: str) -> None:
    base = TrainConfig(terrain="step", network="at_d3qn")
    with pytest.raises(ConfigError, match=text):
        with_overrides(base, {**SETTINGS, **changes})


def test_its_values_are_not_taken_for_returns(run: Path) -> None:
    text = r"controller\.value=.*: it learnt by a policy gradient"
    with pytest.raises(CheckpointError, match=text):
        learned_value(str(run), "controller.value")


def test_a_network_whose_noise_is_off_learns_without_it(tmp_path: Path) -> None:
    """The parameters of its noise have no part in the loss."""
    new = trainer(config(network={"name": "noisy"}, **{"train.decisions": 400}), tmp_path)
    new.run()
    last = checkpoint.read(tmp_path / checkpoint.LAST)
    anchor, online = last.part("anchor"), last.part("online")
    same = {name for name in online if torch.equal(anchor[name], online[name])}
    assert (
        {name for name in online if "sigma" in name} == {n for n in same if "sigma" in n} != set()
    )
    assert len(same) < len(online)
