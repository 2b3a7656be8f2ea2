"""The policy that trains: ε-greedy in the Q-values of a network that may have noise of its own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from flipperctl.agent.acting import greedy
from flipperctl.agent.frames import stacked
from flipperctl.agent.noise import Noise
from flipperctl.api import ACTIONS, Perception, Simulator


class ExploringPolicy:
    """A random action with probability ε, else the greedy one under new noise."""

    def __init__(
        self,
        module: torch.nn.Module,
        frames: int,
        epsilon: Callable[[], float],
        rng: np.random.Generator,
        noise_rng: np.random.Generator,
    ) -> None:
        """``module`` is in ``train()`` mode; ``frames``: observations that it takes in at once.

        ``epsilon`` is asked at each decision; ``rng`` draws actions, ``noise_rng`` noise.
        """
        self._module, self._frames, self._epsilon = module, frames, epsilon
        self._rng, self._noise_rng = rng, noise_rng
        self._noise = Noise(module)
        self._device = next(module.parameters(), torch.empty(0)).device

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; nothing is remembered from one to the next."""

    def act(self, p: Perception) -> int:
        """Return the index of an action."""
        if self._rng.random() < self._epsilon():
            return int(self._rng.integers(len(ACTIONS)))
        self._noise.draw(self._noise_rng)
        return greedy(self._module, stacked(p.recent, self._frames), self._device)
