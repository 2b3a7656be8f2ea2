"""A network that explores with learnt noise."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from pydantic import Field, PositiveInt

from flipperctl.api import Network, ObservationLayout, network

if TYPE_CHECKING:
    import torch


@network("noisy")
class Noisy(Network):
    """AT-D3QN with noisy heads (Fortunato et al. 2018), which explore without ε-greedy actions.

    Train it with ``agent.epsilon_start=0 agent.epsilon_end=0``.
    """

    terrain: tuple[PositiveInt, ...] = Field(
        (64, 64), min_length=1, description="widths of the terrain layers [-]"
    )
    fused: int = Field(128, ge=1, le=4096, description="width of S′ [-]")
    head: int = Field(128, ge=1, le=4096, description="width of each head's layer [-]")
    noise: float = Field(
        0.5, gt=0, le=10, description="σ₀; the noise starts with a deviation of σ₀ / √inputs [-]"
    )

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module that maps observations (B, N + 3) to Q-values (B, n_actions)."""
        from torch import nn

        from .modules import (
            Dueling,
            Fusion,
            NoisyLinear,
            Normalise,
            perceptron,
        )

        terrain = perceptron((layout.bins, *self.terrain))
        linear = partial(NoisyLinear, sigma=self.noise)
        return nn.Sequential(
            Normalise(layout),
            Fusion(layout, terrain, self.terrain[-1], self.fused),
            Dueling(self.fused, self.head, n_actions, linear),
        )
