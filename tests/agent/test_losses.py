"""The mathematics of double Q-learning against numbers worked by hand."""

import pytest
import torch

from flipperctl.agent.losses import double_q_target, huber
from flipperctl.agent.schedules import linear


def test_the_online_network_chooses_and_the_target_network_values() -> None:
    online = torch.tensor([[1.0, 3.0, 2.0], [0.0, -1.0, -2.0], [5.0, 6.0, 7.0]])
    target = torch.tensor([[10.0, 20.0, 30.0], [4.0, 9.0, 9.0], [1.0, 2.0, 3.0]])
    value = double_q_target(
        reward=torch.tensor([1.0, -2.0, 0.5]),
        discount=torch.tensor([0.5, 0.25, 0.0]),
        next_online=online,
        next_target=target,
    )
    # 1 + 0.5 · 20, -2 + 0.25 · 4 (not the larger 9), and the reward alone where the episode ended
    assert value.tolist() == [11.0, -1.0, 0.5]


def test_the_loss_is_quadratic_near_zero_and_linear_far_out() -> None:
    # (0.5² / 2 + (3 - 1/2)) / 2 = (0.125 + 2.5) / 2
    loss = huber(torch.tensor([0.5, 3.0]), torch.zeros(2))
    assert loss.item() == pytest.approx(1.3125)


@pytest.mark.parametrize(
    ("share", "value"), [(-1.0, 4.0), (0.0, 4.0), (0.25, 3.5), (1.0, 2.0), (3.0, 2.0)]
)
def test_a_schedule_is_linear_and_stays_at_its_ends(share: float, value: float) -> None:
    assert linear(4.0, 2.0, share) == value
