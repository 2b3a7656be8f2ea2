"""The learner of the risk: its labels, its loss, and that it leaves the policy alone."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from flipperctl.agent.replay import UNKNOWN, Batch, Replay
from flipperctl.agent.risk import (
    POSITIVES,
    Risk,
    RiskLearner,
    RiskNetwork,
    policy_arrays,
    risk_loss,
    uncalibrated,
)
from flipperctl.checkpoint import join
from flipperctl.core.risk import LAGS, RiskCalibration, RiskSign, resemblances
from tests.agent.learners import LAYOUT, fixed_batch, learner

CPU = torch.device("cpu")


def episode(replay: Replay, decisions: int, failed: bool | None, still: bool = False) -> None:
    """Add an episode whose observations are the numbers of the decisions, or all the same."""
    for t in range(decisions):
        here, there = (np.full(2, 0 if still else i, np.float32) for i in (t, t + 1))
        over = t == decisions - 1
        replay.add(here, 0, 0.0, there, over=over, bootstrap=False, failed=failed)


def replay_of(capacity: int, n_step: int = 2) -> Replay:
    return Replay(capacity, 2, n_step, 0.9, risk_horizon=3, newest=2)


def test_the_last_decisions_of_a_failed_episode_are_marked_once_it_has_ended() -> None:
    replay = replay_of(20)
    episode(replay, 5, True)
    episode(replay, 4, False)
    here = np.zeros(2, np.float32)
    for _ in range(3):  # which goes on
        replay.add(here, 0, 0.0, here, over=False, bootstrap=False)
    expected = [0, 0, 1, 1, 1, 0, 0, 0, 0, UNKNOWN, UNKNOWN]
    assert replay.arrays["failing"][: len(replay)].tolist() == expected
    replay.drop_pending()  # as at the end of the budget
    episode(replay, 2, True)
    assert replay.filled()["failing"].tolist() == [*expected, 1, 1]


def test_an_episode_that_overwrites_itself_is_marked_where_it_is_left() -> None:
    replay = replay_of(4, n_step=1)
    episode(replay, 6, True)
    assert replay.filled()["observation"][:, 0].tolist() == [4, 5, 2, 3]
    assert replay.filled()["failing"].tolist() == [1, 1, 0, 1]


def test_each_resemblance_adds_its_coefficient_to_the_log_odds() -> None:
    torch.manual_seed(0)
    network, rows = RiskNetwork(2), torch.eye(2)
    alone, coefficients = network(rows)
    resembles = torch.zeros(2, len(LAGS))
    resembles[1, :2] = 1.0
    found = network.log_odds(rows, resembles).tolist()
    expected = [alone[0, 0], alone[1, 0] + coefficients[1, 0] + coefficients[1, 1]]
    # The terms nearly cancel for some weights, and single precision sums them in another order.
    assert found == pytest.approx([number.item() for number in expected], abs=1e-6)


def test_before_a_validation_the_weight_of_failures_is_taken_back() -> None:
    # Each failure counts as much as POSITIVES others, so that equal odds are 1 to POSITIVES.
    assert uncalibrated(3).shift == pytest.approx(math.log(1 / POSITIVES))


def test_resemblances_are_those_of_the_newest_observation_in_its_episode() -> None:
    replay = replay_of(10)
    episode(replay, 3, False, still=True)
    assert replay.filled()["resembles"][:, :3].tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    episode(replay, 2, None)  # of a teacher's recording
    assert replay.filled()["failing"].tolist() == [0, 0, 0, UNKNOWN, UNKNOWN]


def test_the_loss_weighs_positives_and_leaves_unknown_labels_out() -> None:
    output = torch.tensor([0.0, 0.0, 9.0])
    found = risk_loss(output, torch.tensor([1.0, 0.0, UNKNOWN]))
    assert float(found) == pytest.approx((POSITIVES + 1) * math.log(2) / 2)
    assert float(risk_loss(output, torch.full((3,), UNKNOWN))) == 0.0


def labelled(size: int = 256) -> Batch:
    """Return decisions of which those with a positive first number that repeat fail soon."""
    made, rows = fixed_batch(size), torch.arange(size)
    resembles = (rows % 2).to(torch.float32).unsqueeze(1).expand(size, len(LAGS)).contiguous()
    failing = (made.observation[:, 0] > 0) & (rows % 2 == 1)
    return replace(made, failing=failing.to(torch.float32), resembles=resembles)


def test_it_learns_what_only_observation_and_recurrence_tell_together() -> None:
    made, network = labelled(), RiskLearner(LAYOUT.size, seed=0, device=CPU)
    for _ in range(200):
        network.step(made, 1e-2)
    assert made.failing is not None
    assert made.resembles is not None
    odds = network.network.log_odds(made.observation, made.resembles)
    right = (odds > math.log(POSITIVES)) == (made.failing > 0)
    assert float(right.to(torch.float32).mean()) > 0.98


def test_the_policy_learns_bit_for_bit_the_same_with_a_risk() -> None:
    plain, risky = learner(), learner(risk=True)
    for step in range(3):
        assert plain.update(fixed_batch(), step / 3) == risky.update(labelled(64), step / 3)
    ours, theirs = join(risky.tensors()), join(plain.tensors())
    assert all(torch.equal(ours[name], tensor) for name, tensor in theirs.items())
    assert not any(name.startswith("risk") for name in theirs)
    assert risky.risk is not None
    network = risky.risk.network
    assert policy_arrays(risky.policy, network).keys() > policy_arrays(plain.policy, None).keys()


def test_a_calibration_scales_log_odds_and_coefficients() -> None:
    network = RiskNetwork(2)
    risk = Risk(network, RiskCalibration(RiskSign(10, 0.5), 2.0, -1.0))
    rows = torch.randn(3, 2, generator=torch.Generator().manual_seed(0))
    alone, coefficients = network(rows)
    found, scaled = risk(rows)
    assert torch.allclose(found, torch.sigmoid(2 * alone - 1))
    assert torch.allclose(scaled, 2 * coefficients)
    observations = rows[:2].numpy()
    resembles = torch.from_numpy(resemblances(observations)[1:])
    odds = network.log_odds(rows[1:2], resembles)
    expected = 1 / (1 + math.exp(-(2 * float(odds.detach()) - 1)))
    episode = risk.begin(2)
    told = [risk.of_one(row, episode) for row in observations]
    assert told[1] == pytest.approx(expected, abs=1e-6)
