"""The policy of training episodes: ε-greedy, with the network's own noise if it has any.

Random actions may persist (εz-greedy; Dabney, Ostrovski and Barreto 2021), here for a geometrically
distributed number of decisions.
"""

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
        persistence: float = 1.0,
        share: float = 1.0,
    ) -> None:
        """``module`` must be in ``train()`` mode.

        ``frames``: number of observations that the network takes as one input. ``epsilon`` is
        called at each decision. ``rng`` draws the actions, ``noise_rng`` the noise.
        ``persistence``: mean number of decisions for which a random action is kept [-]; ``share``:
        share of the episodes that have random actions [-].
        """
        self._module, self._frames, self._epsilon = module, frames, epsilon
        self._rng, self._noise_rng = rng, noise_rng
        self._noise = Noise(module)
        self._device = next(module.parameters(), torch.empty(0)).device
        self._persistence, self._share = persistence, share
        self._greedy = False
        self._action, self._left = 0, 0
        self.explored = False
        """Whether the last action was random."""

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; decide whether it has random actions."""
        self._left = 0
        self._greedy = self._share < 1 and self._rng.random() >= self._share

    def act(self, p: Perception) -> int:
        """Return the index of a random or greedy action."""
        self.explored = self._explores()
        if self.explored:
            return self._action
        self._noise.draw(self._noise_rng)
        return greedy(self._module, stacked(p.recent, self._frames), self._device)

    def _explores(self) -> bool:
        """Continue or begin a random action; return False for a greedy one."""
        if self._greedy:
            return False
        if self._left:
            self._left -= 1
            return True
        if self._rng.random() >= start_probability(self._epsilon(), self._persistence):
            return False
        self._action = int(self._rng.integers(len(ACTIONS)))
        if self._persistence > 1:
            self._left = int(self._rng.geometric(1 / self._persistence)) - 1
        return True


def start_probability(epsilon: float, persistence: float) -> float:
    """Return the probability that a random action begins after a greedy or a finished random one.

    The fraction of random actions is then ``epsilon`` if they last ``persistence`` decisions in the
    mean, whatever that is.
    """
    if persistence == 1:
        return epsilon
    return epsilon / (persistence * (1 - epsilon) + epsilon)
