"""The policy of a policy gradient's episodes: it draws its actions by their Q-values."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from flipperctl.agent.acting import q_values
from flipperctl.agent.frames import stacked
from flipperctl.api import Perception, Simulator, StateGroups
from flipperctl.core.escape import drawn
from flipperctl.policies import labels


class DrawingPolicy:
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
        self.label = labels.none()
        """Probabilities of the actions at the last decision, (9,)."""

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; nothing is remembered."""
        self._module.eval()  # at each decision it took a tenth of the time

    def act(self, p: Perception) -> int:
        """Return the index of the drawn action."""
        observation = stacked(p.recent, self._frames)
        values = q_values(self._module, observation, self._device)
        self.label = labels.from_costs(-np.array(values), self._temperature())
        return drawn(self.label.tolist(), self._rng.random())
