"""The part of all actions' values that only the simulation can tell: an asymmetric dueling head.

How much an episode still returns depends mostly on ground that the robot does not perceive yet.
For the network that acts this is noise, larger than the differences between its actions. A second
network therefore sees the privileged state during the training, and adds one number to the values
of all actions; the greedy action does not depend on it, and policies do not contain it. (Actors and
critics with different inputs: Pinto et al. 2018, "Asymmetric actor critic"; baselines that depend
on the input of a process: Mao et al. 2019.)
"""

from __future__ import annotations

import copy
from typing import Final

import torch

from flipperctl.agent.replay import Batch

PULL: Final = 0.01
"""Weight of the mean squared output in the loss [-]: what the acting network can tell from its
observation then becomes part of its own values, whose mean would otherwise be arbitrary."""
_WIDTH: Final = 128


class Baseline(torch.nn.Module):
    """Maps an observation and the privileged state to a value for all actions."""

    def __init__(self, observation: int, privileged: int, width: int = _WIDTH) -> None:
        """``observation``, ``privileged``: lengths of the rows; ``width`` of the hidden layers."""
        super().__init__()
        self.layers = torch.nn.Sequential(
            *(torch.nn.Linear(observation + privileged, width), torch.nn.ReLU()),
            *(torch.nn.Linear(width, width), torch.nn.ReLU()),
            torch.nn.Linear(width, 1),
        )

    def forward(self, observation: torch.Tensor, privileged: torch.Tensor) -> torch.Tensor:
        """Return the values, (B,), of rows (B, …)."""
        found: torch.Tensor = self.layers(torch.cat([observation, privileged], dim=1))
        return found.squeeze(1)


class Baselines(torch.nn.Module):
    """The baseline that learns, and its target, which follows it slowly."""

    def __init__(self, observation: int, privileged: int) -> None:
        """``observation``, ``privileged``: lengths of the rows."""
        super().__init__()
        self.online = Baseline(observation, privileged)
        self.target = copy.deepcopy(self.online).requires_grad_(False).eval()

    def with_next(self, targets: torch.Tensor, batch: Batch) -> torch.Tensor:
        """Return targets (B, …) of the acting network with the baseline of the next state."""
        assert batch.next_privileged is not None  # as every batch of such a training
        value = batch.discount * self.target(batch.next_observation, batch.next_privileged)
        return targets + _as_column(value, targets)

    def without_present(
        self, targets: torch.Tensor, batch: Batch
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return what of the targets (B, …) is left to the acting network, and the pull to 0."""
        assert batch.privileged is not None  # as every batch of such a training
        value = self.online(batch.observation, batch.privileged)
        return targets - _as_column(value, targets), PULL * value.square().mean()


def _as_column(value: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
    """Return values (B,) in a shape that broadcasts to targets (B,) or (B, K)."""
    return value if targets.ndim == 1 else value.unsqueeze(1)
