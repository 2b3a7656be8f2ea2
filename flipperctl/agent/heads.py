"""What a network says of an action's return, and how that is learnt: a number, or quantiles."""

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
    """A network that gives quantiles of each action's return."""

    def quantiles(self, observation: torch.Tensor, /) -> torch.Tensor:
        """K equally likely values an action, (B, A, K)."""


class Head(Protocol):
    """How the online network learns from a target network."""

    def targets(
        self, reward: torch.Tensor, batch: Batch, online: torch.nn.Module, target: torch.nn.Module
    ) -> torch.Tensor:
        """What the actions of a batch were worth, (B, …); ``reward`` (B,) is the scaled one."""

    def loss(
        self,
        online: torch.nn.Module,
        observation: torch.Tensor,
        action: torch.Tensor,
        targets: torch.Tensor,
    ) -> torch.Tensor:
        """How far the network is from the targets of the actions, (B,), that were taken."""


class Scalar:
    """One Q-value an action, by the Huber loss."""

    def targets(
        self, reward: torch.Tensor, batch: Batch, online: torch.nn.Module, target: torch.nn.Module
    ) -> torch.Tensor:
        """A number each, (B,)."""
        following = batch.next_observation
        return double_q_target(reward, batch.discount, online(following), target(following))

    def loss(
        self,
        online: torch.nn.Module,
        observation: torch.Tensor,
        action: torch.Tensor,
        targets: torch.Tensor,
    ) -> torch.Tensor:
        """Of the Q-values."""
        taken = online(observation).gather(1, action.unsqueeze(1)).squeeze(1)
        return huber(taken, targets)


class Quantile:
    """K quantiles an action, by quantile regression (Dabney et al. 2018)."""

    def targets(
        self, reward: torch.Tensor, batch: Batch, online: torch.nn.Module, target: torch.nn.Module
    ) -> torch.Tensor:
        """K equally likely numbers each, (B, K)."""
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
        """Of the quantiles."""
        quantiles = cast("Distributional", online).quantiles(observation)
        rows = torch.arange(len(action), device=action.device)
        return quantile_huber(quantiles[rows, action], targets)


def head(module: torch.nn.Module) -> Head:
    """The one that fits what the module offers."""
    return Quantile() if isinstance(module, Distributional) else Scalar()
