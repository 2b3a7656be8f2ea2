"""The mathematics of double Q-learning as pure functions."""

from __future__ import annotations

import torch


def double_q_target(
    reward: torch.Tensor,
    discount: torch.Tensor,
    next_online: torch.Tensor,
    next_target: torch.Tensor,
) -> torch.Tensor:
    """R + γ · Q_target(s′, argmax_a Q_online(s′, a)), shape (B,). van Hasselt et al. 2016.

    ``reward`` and ``discount`` are (B,), the discount 0 where the episode ended for good;
    ``next_online`` and ``next_target`` are (B, A) at the next observation.
    """
    best = next_online.argmax(dim=1, keepdim=True)  # (B, 1)
    return reward + discount * next_target.gather(1, best).squeeze(1)


def huber(prediction: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Mean Huber loss with threshold 1 of two (B,) tensors."""
    return torch.nn.functional.smooth_l1_loss(prediction, target)
