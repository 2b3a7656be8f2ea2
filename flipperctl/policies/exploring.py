"""The policies of training episodes: ε-greedy, or drawn by their Q-values.
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
A network's own noise, if it has any, replaces ε. Draws are those of the policy gradient.
from flipperctl.policies.teaching import from_costs, none
"""
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
from __future__ import annotations
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
from collections.abc import Callable
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
import numpy as np
from flipperctl.policies.teaching import from_costs, none
import torch
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
from flipperctl.agent.frames import stacked
from flipperctl.policies.teaching import from_costs, none
from flipperctl.agent.networks import greedy, q_values
from flipperctl.policies.teaching import from_costs, none
from flipperctl.agent.noise import Noise
from flipperctl.policies.teaching import from_costs, none
from flipperctl.api import (
from flipperctl.policies.teaching import from_costs, none
    ACTIONS,
from flipperctl.policies.teaching import from_costs, none
    Perception,
from flipperctl.policies.teaching import from_costs, none
    Simulator,
from flipperctl.policies.teaching import from_costs, none
    StateGroups,
from flipperctl.policies.teaching import from_costs, none
)
from flipperctl.policies.teaching import from_costs, none
from flipperctl.core.risk import drawn
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
class ExploringPolicy:
from flipperctl.policies.teaching import from_costs, none
    """Takes a random action with probability ε, otherwise the greedy action under new noise."""
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
    def __init__(
from flipperctl.policies.teaching import from_costs, none
        self,
from flipperctl.policies.teaching import from_costs, none
        module: torch.nn.Module,
from flipperctl.policies.teaching import from_costs, none
        frames: int,
from flipperctl.policies.teaching import from_costs, none
        epsilon: Callable[[], float],
from flipperctl.policies.teaching import from_costs, none
        rng: np.random.Generator,
from flipperctl.policies.teaching import from_costs, none
        noise_rng: np.random.Generator,
from flipperctl.policies.teaching import from_costs, none
        share: float = 1.0,
from flipperctl.policies.teaching import from_costs, none
    ) -> None:
from flipperctl.policies.teaching import from_costs, none
        """``module`` is put into the mode of decisions at the start of each episode.
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
        ``frames``: number of observations that the network takes as one input. ``epsilon`` is
from flipperctl.policies.teaching import from_costs, none
        called at each decision. ``rng`` draws the actions, ``noise_rng`` the noise.
from flipperctl.policies.teaching import from_costs, none
        ``share``: share of the episodes that have random actions [-].
from flipperctl.policies.teaching import from_costs, none
        """
from flipperctl.policies.teaching import from_costs, none
        self._module, self._frames, self._epsilon = module, frames, epsilon
from flipperctl.policies.teaching import from_costs, none
        self._rng, self._noise_rng = rng, noise_rng
from flipperctl.policies.teaching import from_costs, none
        self._noise = Noise(module)
from flipperctl.policies.teaching import from_costs, none
        self._device = next(module.parameters(), torch.empty(0)).device
from flipperctl.policies.teaching import from_costs, none
        self._share, self._greedy = share, False
from flipperctl.policies.teaching import from_costs, none
        self.explored = False
from flipperctl.policies.teaching import from_costs, none
        """Whether the last action was random."""
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
    def reset(self, simulator: Simulator) -> None:
from flipperctl.policies.teaching import from_costs, none
        """Begin an episode; decide whether it has random actions."""
from flipperctl.policies.teaching import from_costs, none
        self._noise.acts()
from flipperctl.policies.teaching import from_costs, none
        self._greedy = self._share < 1 and self._rng.random() >= self._share
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
    def act(self, p: Perception) -> int:
from flipperctl.policies.teaching import from_costs, none
        """Return the index of a random or greedy action."""
from flipperctl.policies.teaching import from_costs, none
        self.explored = not self._greedy and self._rng.random() < self._epsilon()
from flipperctl.policies.teaching import from_costs, none
        if self.explored:
from flipperctl.policies.teaching import from_costs, none
            return int(self._rng.integers(len(ACTIONS)))
from flipperctl.policies.teaching import from_costs, none
        self._noise.draw(self._noise_rng)
from flipperctl.policies.teaching import from_costs, none
        return greedy(self._module, stacked(p.recent, self._frames), self._device)
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
class DrawingPolicy:
from flipperctl.policies.teaching import from_costs, none
    """Draws each action with the probabilities softmax(Q / temperature), which are its label."""
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
    groups: StateGroups | None = None
from flipperctl.policies.teaching import from_costs, none
    explored = False
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
    def __init__(
from flipperctl.policies.teaching import from_costs, none
        self,
from flipperctl.policies.teaching import from_costs, none
        module: torch.nn.Module,
from flipperctl.policies.teaching import from_costs, none
        frames: int,
from flipperctl.policies.teaching import from_costs, none
        temperature: Callable[[], float],
from flipperctl.policies.teaching import from_costs, none
        rng: np.random.Generator,
from flipperctl.policies.teaching import from_costs, none
    ) -> None:
from flipperctl.policies.teaching import from_costs, none
        """``module`` is put into ``eval()`` mode at the start of each episode.
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
        ``frames``: number of observations that the network takes as one input. ``rng`` draws.
from flipperctl.policies.teaching import from_costs, none
        ``temperature``: called at each decision [-].
from flipperctl.policies.teaching import from_costs, none
        """
from flipperctl.policies.teaching import from_costs, none
        self._module, self._frames = module, frames
from flipperctl.policies.teaching import from_costs, none
        self._temperature, self._rng = temperature, rng
from flipperctl.policies.teaching import from_costs, none
        self._device = next(module.parameters(), torch.empty(0)).device
from flipperctl.policies.teaching import from_costs, none
        self.label = none()
from flipperctl.policies.teaching import from_costs, none
        """Probabilities of the actions at the last decision, (9,)."""
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
    def reset(self, simulator: Simulator) -> None:
from flipperctl.policies.teaching import from_costs, none
        """Begin an episode; nothing is remembered."""
from flipperctl.policies.teaching import from_costs, none
        self._module.eval()  # at each decision it took a tenth of the time
from flipperctl.policies.teaching import from_costs, none

from flipperctl.policies.teaching import from_costs, none
    def act(self, p: Perception) -> int:
from flipperctl.policies.teaching import from_costs, none
        """Return the index of the drawn action."""
from flipperctl.policies.teaching import from_costs, none
        observation = stacked(p.recent, self._frames)
from flipperctl.policies.teaching import from_costs, none
        values = q_values(self._module, observation, self._device)
from flipperctl.policies.teaching import from_costs, none
        self.label = from_costs(-np.array(values), self._temperature())
from flipperctl.policies.teaching import from_costs, none
        return drawn(self.label.tolist(), self._rng.random())
from flipperctl.policies.teaching import from_costs, none
