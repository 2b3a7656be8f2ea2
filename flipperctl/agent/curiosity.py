"""Curiosity: a reward of the learner's own for transitions that it cannot predict yet.

In: batches of single transitions. Out: what is added to their rewards, and gradient steps of the
predicting networks. Pathak et al. 2017, "Curiosity-driven exploration by self-supervised
prediction" (ICM); for flippers Pan et al. 2023, Remote Sensing 15:4616 (ICM-D3QN). Features of two
observations tell the action between them (the inverse model), so that what no action changes does
not count. The curiosity is the error with which the action and the first features predict the
second ones.
"""

from __future__ import annotations

import math
from typing import Final

import torch
from torch.nn import functional

from flipperctl.agent.losses import Adam, flatten_parameters
from flipperctl.agent.replay import Batch
from flipperctl.errors import NonFiniteError

FEATURES: Final = 32
_WIDTH: Final = 128
FORWARD: Final = 0.2
"""Weight of the forward model's loss; that of the inverse model is the rest [-]."""


class PredictingNetworks(torch.nn.Module):
    """Features of an observation, the inverse and the forward model."""

    def __init__(self, inputs: int, actions: int) -> None:
        """``inputs``: length of an input row; ``actions``: number of actions."""
        super().__init__()
        self.actions = actions

        def layers(size: int, out: int) -> torch.nn.Sequential:
            hidden = torch.nn.Linear(size, _WIDTH), torch.nn.ReLU()
            return torch.nn.Sequential(*hidden, torch.nn.Linear(_WIDTH, out))

        self.features = layers(inputs, FEATURES)
        self.inverse = layers(2 * FEATURES, actions)
        self.ahead = layers(FEATURES + actions, FEATURES)

    def forward(self, batch: Batch) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the log-odds of actions, (B, 9), and half the squared errors ahead, (B,)."""
        before, after = self.features(batch.observation), self.features(batch.next_observation)
        odds = self.inverse(torch.cat([before, after], dim=1))
        action = functional.one_hot(batch.action, self.actions).to(before.dtype)
        # The features learn from the inverse model alone: both together could become constant.
        predicted = self.ahead(torch.cat([before.detach(), action], dim=1))
        return odds, 0.5 * (predicted - after.detach()).square().sum(dim=1)


class Curiosity:
    """The predicting networks of a training with their own optimiser."""

    def __init__(self, inputs: int, actions: int, *, seed: int, device: torch.device) -> None:
        """``inputs``: length of an input row; ``seed``: of the first weights."""
        # Weights follow from the seed; torch's global generator is restored afterwards.
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.network = PredictingNetworks(inputs, actions).to(device)
        self._parameters = list(self.network.parameters())
        self.optimiser = Adam(flatten_parameters(list(self.network.parameters())))

    def reward(self, batch: Batch) -> torch.Tensor:
        """Return the error of the forward model for each transition, (B,) [-]."""
        with torch.no_grad():
            error: torch.Tensor = self.network(batch)[1]
        return error

    def step(self, batch: Batch, rate: float) -> float:
        """Take a gradient step with the learning rate ``rate``; return the loss [-]."""
        odds, errors = self.network(batch)
        inverse = functional.cross_entropy(odds, batch.action)
        # ICM's loss: the inverse model shapes the features, the forward model measures surprise.
        loss = (1 - FORWARD) * inverse + FORWARD * errors.mean()
        if not math.isfinite(value := float(loss.detach())):
            raise NonFiniteError(f"the loss of the curiosity is {value}")
        gradients = torch.autograd.grad(loss, self._parameters)
        with torch.no_grad():
            self.optimiser.step(torch.cat([g.reshape(-1) for g in gradients]), rate)
        return value
