"""The mathematics of the learner against numbers worked by hand."""

import math

import numpy as np
import pytest
import torch

from flipperctl.agent.frames import stacked
from flipperctl.agent.losses import (
    Adam,
    descend,
    double_q_target,
    double_quantile_target,
    huber,
    mean_value_penalty,
    quantile_huber,
    searched_values,
    teacher_cross_entropy,
    teacher_large_margin,
)
from flipperctl.learners.settings import linear


def test_the_online_network_chooses_and_the_target_network_values() -> None:
    online = torch.tensor([[1.0, 3.0, 2.0], [0.0, -1.0, -2.0], [5.0, 6.0, 7.0]])
    target = torch.tensor([[10.0, 20.0, 30.0], [4.0, 9.0, 9.0], [1.0, 2.0, 3.0]])
    reward, discount = torch.tensor([1.0, -2.0, 0.5]), torch.tensor([0.5, 0.25, 0.0])
    value = double_q_target(reward, discount, online, target)
    # 1 + 0.5 · 20, -2 + 0.25 · 4 (not the larger 9), and the reward alone where the episode ended
    assert value.tolist() == [11.0, -1.0, 0.5]


def test_the_loss_is_quadratic_near_zero_and_linear_far_out() -> None:
    # (0.5² / 2 + (3 - 1/2)) / 2 = (0.125 + 2.5) / 2
    loss = huber(torch.tensor([0.5, 3.0]), torch.zeros(2))
    assert loss.item() == pytest.approx(1.3125)
    weighted = huber(torch.tensor([0.5, 3.0]), torch.zeros(2), torch.tensor([1.6, 0.4]))
    assert weighted.item() == pytest.approx((1.6 * 0.125 + 0.4 * 2.5) / 2)


def test_the_distribution_of_the_online_network_s_choice_is_scaled_and_shifted() -> None:
    target = torch.tensor([[[0.0, 2.0], [4.0, 8.0]], [[1.0, 1.0], [9.0, 9.0]]])
    reward, discount = torch.tensor([1.0, -2.0]), torch.tensor([0.5, 0.0])
    online = torch.tensor([[1.0, 3.0], [0.0, -1.0]])
    found = double_quantile_target(reward, discount, online, target)
    # 1 + 0.5 · (4, 8); the episode ended in the other
    assert found.tolist() == [[3.0, 5.0], [-2.0, -2.0]]


def test_the_quantile_loss_by_hand() -> None:
    # Quantiles 0 and 2 at τ = ¼ and ¾; values 1 and 4. Huber of the errors 1, 4 and -1, 2:
    # ½, 3½ and ½, 1½; weights ¼, ¼ (too low) and |¾ - 1| = ¼ (too high), ¾.
    # (¼ · ½ + ¼ · 3½) / 2 + (¼ · ½ + ¾ · 1½) / 2 = ½ + 0.625
    loss = quantile_huber(torch.tensor([[0.0, 2.0]]), torch.tensor([[1.0, 4.0]]))
    assert loss.item() == pytest.approx(1.125)
    rows = torch.tensor([[0.0, 2.0]] * 2), torch.tensor([[1.0, 4.0], [0.0, 2.0]])
    one, other = quantile_huber(rows[0][:1], rows[1][:1]), quantile_huber(rows[0][1:], rows[1][1:])
    weighted = quantile_huber(*rows, torch.tensor([0.5, 1.5]))
    assert weighted.item() == pytest.approx((0.5 * one.item() + 1.5 * other.item()) / 2)


@pytest.mark.parametrize(
    ("fraction", "value"), [(-1.0, 4.0), (0.0, 4.0), (0.25, 3.5), (1.0, 2.0), (3.0, 2.0)]
)
def test_a_schedule_is_linear_and_stays_at_its_ends(fraction: float, value: float) -> None:
    assert linear(4.0, 2.0, fraction) == value


def test_the_teachers_cross_entropy_by_hand() -> None:
    values = torch.tensor([[0.0, 0.2], [5.0, -5.0], [0.0, 0.0]])
    labels = torch.tensor([[0.25, 0.75], [0.0, 0.0], [1.0, 0.0]])  # the second row has no label
    # softmax([0, 2]) is 1 / (1 + e²) and e² / (1 + e²); softmax([0, 0]) is one half each.
    base = math.log(1 + math.exp(2))
    expected = (0.25 * base + 0.75 * (base - 2) + math.log(2)) / 2
    assert float(teacher_cross_entropy(values, labels, 0.1)) == pytest.approx(expected)
    none = torch.zeros(3, 2)
    assert float(teacher_cross_entropy(values, none, 0.1)) == 0.0


def test_the_large_margin_by_hand() -> None:
    values = torch.tensor([[1.0, 0.9, 0.0], [0.0, 0.2, 3.0], [0.5, 0.5, 0.5], [9.0, 0.0, 0.0]])
    labels = torch.tensor(
        [[1.0, 0.0, 0.0], [0.1, 0.8, 0.1], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]
    )  # the last row has no label
    # 0.9 + 0.25 - 1; 3 + 0.25 - 0.2 against the most probable action, 1; a tie costs the margin
    expected = (0.15 + 3.05 + 0.25) / 3
    assert float(teacher_large_margin(values, labels, 0.25)) == pytest.approx(expected)
    # With a margin below its lead of 0.1, the first row costs nothing.
    assert float(teacher_large_margin(values[:1], labels[:1], 0.05)) == 0.0
    assert float(teacher_large_margin(values, torch.zeros(4, 3), 0.25)) == 0.0


def test_the_mean_value_penalty_is_drawn_to_zero_and_the_differences_are_left_alone() -> None:
    values = torch.tensor([[3.0, 1.0, 2.0], [-1.0, 0.0, 1.0]], requires_grad=True)
    loss = mean_value_penalty(values)
    assert loss.item() == pytest.approx(2.0)  # (2² + 0²) / 2
    loss.backward()
    assert values.grad is not None
    assert values.grad[0].tolist() == pytest.approx([2 / 3] * 3)
    assert values.grad[1].tolist() == [0.0] * 3


def searched() -> torch.Tensor:
    """Return values of three actions of two states of two groups, (2, 2, 3)."""
    return torch.tensor(
        [[[1.0, 0.0, 0.5], [3.0, 4.0, 3.5]], [[-6.0, -5.0, -5.5], [-2.0, -2.5, -3.0]]]
    )


def test_a_common_offset_of_a_group_costs_a_tenth_of_its_size() -> None:
    """The best values are 1, 4 and -5, -2: 1.5 off the means of their groups."""
    offset = torch.tensor([4.0, -3.0]).view(2, 1, 1)
    loss = searched_values(searched() + offset, searched(), 5.0)
    # 0.1 · mean(4 / 1.5 - 1/2, 3 / 1.5 - 1/2)
    assert float(loss) == pytest.approx(0.1 * (4 / 1.5 + 3 / 1.5 - 1) / 2, rel=1e-4)
    within = torch.tensor([[4.0, -4.0], [0.0, 0.0]]).view(2, 2, 1)
    assert float(searched_values(searched() + within, searched(), 5.0)) > 1.0


def test_a_bad_action_may_be_rated_even_worse_but_not_better() -> None:
    targets = searched()
    targets[0, 0, 1] = -500.0
    worse, better = targets.clone(), targets.clone()
    worse[0, 0, 1], better[0, 0, 1] = -900.0, 0.5
    assert float(searched_values(worse, targets, 2.0)) == 0.0
    assert float(searched_values(better, targets, 2.0)) > 0.1
    # Short of the clip, a gap counts on both sides.
    worse, better = searched(), searched()
    worse[0, 0, 2] -= 0.2
    better[0, 0, 2] += 0.2
    losses = [float(searched_values(v, searched(), 5.0)) for v in (worse, better)]
    assert losses[0] == pytest.approx(losses[1])
    assert losses[0] > 0.01


def test_where_most_actions_are_equal_the_others_give_the_scale() -> None:
    """As with a reward at the end alone. The median of the differences is 0 there."""
    targets = torch.zeros(2, 2, 5)
    targets[:, 0, 4], targets[0] = -1.0, targets[0] + 2.0
    targets[0, 1, 3] = 1.0
    close = targets.clone()
    close[:, :, 1] -= 0.01  # a hundredth of the differences that there are
    flat = targets.max(dim=2, keepdim=True).values.expand_as(targets)
    found, ignored = (float(searched_values(values, targets, 5.0)) for values in (close, flat))
    assert 0.0 < found < 0.1
    assert ignored > 0.3


def test_no_reward_s_scale_matters_for_the_searched_values() -> None:
    found = searched() + torch.linspace(-1.0, 1.0, 12).view(2, 2, 3)
    loss = float(searched_values(found, searched(), 3.0))
    assert float(searched_values(100 * found, 100 * searched(), 3.0)) == pytest.approx(
        loss, rel=1e-3
    )
    assert loss > 0.01


# Adam


def test_the_first_step_goes_by_the_rate_against_the_gradients_sign() -> None:
    parameters = torch.tensor([1.0, 2.0, 3.0])
    Adam(parameters).step(torch.tensor([0.5, -4.0, 0.0]), 0.1)
    assert parameters.tolist() == pytest.approx([0.9, 2.1, 3.0])


def test_a_gradient_longer_than_its_norm_is_shortened(monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[list[float]] = []
    monkeypatch.setattr(Adam, "step", lambda self, gradient, rate: steps.append(gradient.tolist()))
    weights = torch.tensor([3.0, 4.0], requires_grad=True)
    for norm in (1.0, 10.0):  # the gradient, the weights themselves, is 5 long
        descend(weights.square().sum() / 2, [weights], Adam(weights), norm, 0.1)
    assert steps == [pytest.approx([0.6, 0.8]), [3.0, 4.0]]


def test_many_steps_are_those_of_the_paper() -> None:
    """Kingma & Ba 2015, Algorithm 1. torch's own optimiser would import its compiler."""
    generator = torch.Generator().manual_seed(0)
    ours, expected = torch.ones(20), torch.ones(20, dtype=torch.float64)
    adam, m, v = Adam(ours), torch.zeros(20), torch.zeros(20)
    for t in range(1, 51):
        gradient = torch.randn(20, generator=generator)
        adam.step(gradient, 3e-3)
        m, v = 0.9 * m + 0.1 * gradient, 0.999 * v + 0.001 * gradient**2
        expected -= 3e-3 * (m / (1 - 0.9**t)) / ((v / (1 - 0.999**t)).sqrt() + 1e-8)
    torch.testing.assert_close(ours.double(), expected, rtol=1e-5, atol=1e-6)


# The input row of a network.

OBSERVATIONS = tuple(np.array([i, -i], np.float32) for i in range(5))


@pytest.mark.parametrize(
    ("recent", "frames", "numbers"),
    [
        (OBSERVATIONS, 1, [4, -4]),
        (OBSERVATIONS, 3, [2, -2, 3, -3, 4, -4]),  # oldest first
        (OBSERVATIONS[1:3], 4, [1, -1, 1, -1, 1, -1, 2, -2]),  # the first is repeated
        (OBSERVATIONS[3:4], 2, [3, -3, 3, -3]),
    ],
)
def test_the_newest_observations_in_a_row(recent: tuple, frames: int, numbers: list[int]) -> None:
    row = stacked(recent, frames)
    assert row.dtype == np.float32
    assert row.tolist() == numbers
