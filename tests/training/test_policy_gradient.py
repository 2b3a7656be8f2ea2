"""Trainings by the policy gradient: in both modes, and with what they do not go with."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from flipperctl import checkpoint
from flipperctl.agent.replay import Replay
from flipperctl.config import with_overrides
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.learners.clipped import GradientLearning
from flipperctl.policies.source import learned_value
from tests.short import few, trainer
from tests.training.conftest import GRADIENT, setup

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run(runs: Callable[[str], Path]) -> Path:
    return runs("gradient")


def test_each_decision_is_drawn_by_probabilities_and_used_once(run: Path) -> None:
    last = checkpoint.read(run / checkpoint.LAST)
    labels = last.part("replay")["label"].numpy()
    assert labels.sum(axis=1) == pytest.approx(np.ones(len(labels)), abs=1e-5)
    assert last.document.state is not None
    counters: Any = last.document.state.learner
    rounds, learnt = counters["rounds"], counters["learnt"]
    policy_steps, value_steps, _ = counters["steps"]
    assert 2 <= rounds <= 4
    assert 50 * rounds <= learnt <= 200
    assert value_steps > policy_steps > 0
    anchor, online = last.part("anchor"), last.part("online")
    assert anchor.keys() == online.keys()  # the policy has moved from its start
    assert any(not torch.equal(anchor[name], online[name]) for name in anchor)


def test_the_part_of_an_episode_that_the_budget_cut_is_not_learnt(run: Path) -> None:
    last = checkpoint.read(run / checkpoint.LAST)
    state, replay = last.document.state, last.part("replay")
    assert state is not None
    assert len(replay["discount"]) < state.decision == 200  # it cuts one
    assert replay["discount"][-1] == 0
    assert (replay["discount"] == 0).sum() == state.episode


def test_a_round_longer_than_the_replay_is_refused(tmp_path: Path) -> None:
    made, row = trainer(setup("gradient"), tmp_path), np.zeros(2, np.float32)
    learning = made.learning
    assert isinstance(learning, GradientLearning)
    learning.replay = Replay(4, size=2, n_step=1, gamma=0.5)
    for step in range(6):
        learning.replay.add(row, 0, 0.0, row, over=step == 5, bootstrap=False)
    with pytest.raises(ConfigError, match=r"agent\.replay_size: 4 decisions .* than the 6 of"):
        learning.end_episode(6)


@pytest.mark.long
def test_workers_draw_too_and_draws_become_sharper_towards_the_end(tmp_path: Path) -> None:
    more = {"train.decisions": 800, "train.validate_every": 800, "agent.decisions": 100}
    sharper = {"agent.temperature_end": 0.001, "train.mode": "fast", **more}
    made = trainer(few(**{**GRADIENT, **sharper}), tmp_path)
    made.run()
    assert isinstance(made.learning, GradientLearning)
    replay = made.learning.replay
    labels = replay.arrays["label"][: len(replay)]
    assert labels.sum(axis=1) == pytest.approx(np.ones(len(labels)), abs=1e-5)
    assert labels[-60:].max(axis=1).mean() > labels[:60].max(axis=1).mean() + 0.2


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"agent.n_step": 3}, "agent.n_step: there is no such key"),
        ({"agent.replay_size": 199, "agent.decisions": 100}, "200 .* or more is"),
        ({"teacher": {"controller": {"name": "okada"}}}, "set teacher=none"),
        ({"agent.start_values": True}, "start_values: true needs a run"),
    ],
)
def test_settings_that_do_not_go_with_it_are_refused(changes: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        with_overrides(few(), {**GRADIENT, **changes})


def test_its_values_are_not_taken_for_returns(run: Path) -> None:
    text = r"controller\.value=.*: it learnt by agent=policy_gradient"
    with pytest.raises(CheckpointError, match=text):
        learned_value(str(run), "controller.value")
