"""The output of a network for each action, a Q-value or quantiles, with its target and loss."""

from __future__ import annotations

from typing import Protocol, cast, runtime_checkable

import torch

from flipperctl.agent.losses import (
    double_q_target,
    double_quantile_target,
    huber,
    quantile_huber,
)
from flipperctl.agent.replay import Batch


@runtime_checkable
class Distributional(Protocol):
    """A network that estimates quantiles of each action's return."""

    def quantiles(self, observation: torch.Tensor, /) -> torch.Tensor:
        """Return K equally likely values of each action's return, (B, A, K)."""


class Head(Protocol):
    """The target and the loss from which the online network learns."""

    def targets(
        self, reward: torch.Tensor, batch: Batch, online: torch.nn.Module, target: torch.nn.Module
    ) -> torch.Tensor:
        """Return the targets of a batch, (B, …), with the scaled rewards ``reward``, (B,)."""

    def loss(
        self,
        online: torch.nn.Module,
        observation: torch.Tensor,
        action: torch.Tensor,
        targets: torch.Tensor,
    ) -> torch.Tensor:
        """Return the loss between the network's outputs for ``action``, (B,), and ``targets``."""


class Scalar:
    """One Q-value for each action, learnt with the Huber loss."""

    def targets(
        self, reward: torch.Tensor, batch: Batch, online: torch.nn.Module, target: torch.nn.Module
    ) -> torch.Tensor:
        """Return the double Q-learning targets, (B,)."""
        next_ = batch.next_observation
        return double_q_target(reward, batch.discount, online(next_), target(next_))

    def loss(
        self,
        online: torch.nn.Module,
        observation: torch.Tensor,
        action: torch.Tensor,
        targets: torch.Tensor,
    ) -> torch.Tensor:
        """Return the Huber loss of the Q-values."""
        predicted = online(observation).gather(1, action.unsqueeze(1)).squeeze(1)
        return huber(predicted, targets)


class Quantile:
    """K quantiles for each action, learnt by quantile regression (Dabney et al. 2018)."""

    def targets(
        self, reward: torch.Tensor, batch: Batch, online: torch.nn.Module, target: torch.nn.Module
    ) -> torch.Tensor:
        """Return the target distributions as K equally likely values, (B, K)."""
        values = online(batch.next_observation)
        quantiles = cast("Distributional", target).quantiles(batch.next_observation)
        return double_quantile_target(reward, batch.discount, values, quantiles)

    def loss(
        self,
        online: torch.nn.Module,
        observation: torch.Tensor,
        action: torch.Tensor,
        targets: torch.Tensor,
    ) -> torch.Tensor:
        """Return the quantile Huber loss of the quantiles."""
        quantiles = cast("Distributional", online).quantiles(observation)
        rows = torch.arange(len(action), device=action.device)
        return quantile_huber(quantiles[rows, action], targets)


def choose_head(module: torch.nn.Module) -> Head:
    """Return the quantile head for a module with ``quantiles``, else the scalar head."""
    return Quantile() if isinstance(module, Distributional) else Scalar()
