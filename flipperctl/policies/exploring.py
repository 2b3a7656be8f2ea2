"""The policy of training episodes: ε-greedy, with the network's own noise if it has any."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from flipperctl.agent.acting import greedy
from flipperctl.agent.frames import stacked
from flipperctl.agent.noise import Noise
from flipperctl.api import ACTIONS, Perception, Simulator


class ExploringPolicy:
    """Takes a random action with probability ε, otherwise the greedy action under new noise."""

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
