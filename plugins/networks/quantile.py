"""A network that learns the distribution of returns instead of its mean."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field, PositiveInt

from flipperctl.api import Network, ObservationLayout, network

if TYPE_CHECKING:
    import torch


@network("quantile")
class Quantile(Network):
    """AT-D3QN whose heads give quantiles of each action's return (Dabney et al. 2018)."""

    terrain: tuple[PositiveInt, ...] = Field(
        (64, 64), min_length=1, description="widths of the terrain layers [-]"
    )
    fused: int = Field(128, ge=1, le=4096, description="width of S′ [-]")
    head: int = Field(128, ge=1, le=4096, description="width of each head's layer [-]")
    quantiles: int = Field(32, ge=1, le=512, description="K, number of quantiles per action [-]")

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module that maps observations (B, N + 3) to Q-values (B, n_actions)."""
        from torch import nn

        from .modules import (
            DuelingQuantiles,
            Fusion,
            Normalise,
            perceptron,
        )

        terrain = perceptron((layout.bins, *self.terrain))
        front = nn.Sequential(
            Normalise(layout), Fusion(layout, terrain, self.terrain[-1], self.fused)
        )
        return DuelingQuantiles(front, self.fused, self.head, n_actions, self.quantiles)
