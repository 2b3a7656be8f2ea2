"""The policies of training episodes: ε-greedy, or drawn by their Q-values.

A network's own noise, if it has any, replaces ε. Draws are those of the policy gradient.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from flipperctl.agent.frames import stacked
from flipperctl.agent.networks import greedy, q_values
from flipperctl.agent.noise import Noise
from flipperctl.api import (
    ACTIONS,
    Perception,
    Simulator,
    StateGroups,
)
from flipperctl.core.risk import drawn
from flipperctl.policies.teaching import from_costs, none


class ExploringPolicy:
    """Takes a random action with probability ε, otherwise the greedy action under new noise."""

    label = None
    groups = None

    def __init__(
        self,
        module: torch.nn.Module,
        frames: int,
        epsilon: Callable[[], float],
        rng: np.random.Generator,
        noise_rng: np.random.Generator,
        share: float = 1.0,
    ) -> None:
        """``module`` is put into the mode of decisions at the start of each episode.

        ``frames``: number of observations that the network takes as one input. ``epsilon`` is
        called at each decision. ``rng`` draws the actions, ``noise_rng`` the noise.
        ``share``: share of the episodes that have random actions [-].
        """
        self._module, self._frames, self._epsilon = module, frames, epsilon
        self._rng, self._noise_rng = rng, noise_rng
        self._noise = Noise(module)
        self._device = next(module.parameters(), torch.empty(0)).device
        self._share, self._greedy = share, False
        self.explored = False
        """Whether the last action was random."""

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; decide whether it has random actions."""
        self._noise.acts()
        self._greedy = self._share < 1 and self._rng.random() >= self._share

    def act(self, p: Perception) -> int:
        """Return the index of a random or greedy action."""
        self.explored = not self._greedy and self._rng.random() < self._epsilon()
        if self.explored:
            return int(self._rng.integers(len(ACTIONS)))
        self._noise.draw(self._noise_rng)
        return greedy(self._module, stacked(p.recent, self._frames), self._device)


class SamplingPolicy:
    """Draws each action with the probabilities softmax(Q / temperature), which are its label."""

    groups: StateGroups | None = None
    explored = False

    def __init__(
        self,
        module: torch.nn.Module,
        frames: int,
        temperature: Callable[[], float],
        rng: np.random.Generator,
    ) -> None:
        """``module`` is put into ``eval()`` mode at the start of each episode.

        ``frames``: number of observations that the network takes as one input. ``rng`` draws.
        ``temperature``: called at each decision [-].
        """
        self._module, self._frames = module, frames
        self._temperature, self._rng = temperature, rng
        self._device = next(module.parameters(), torch.empty(0)).device
        self.label = none()
        """Probabilities of the actions at the last decision, (9,)."""

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; nothing is remembered."""
        self._module.eval()  # at each decision it took a tenth of the time

    def act(self, p: Perception) -> int:
        """Return the index of the drawn action."""
        observation = stacked(p.recent, self._frames)
        values = q_values(self._module, observation, self._device)
        self.label = from_costs(-np.array(values), self._temperature())
        return drawn(self.label.tolist(), self._rng.random())
