"""The paper's network."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field, PositiveInt

from flipperctl.api import Network, ObservationLayout, network

if TYPE_CHECKING:
    import torch


@network("at_d3qn")
class AtD3qn(Network):
    """AT-D3QN (paper Sec. III-E): terrain MLP → H′, fused with E in one layer → S′, dueling."""

    terrain: tuple[PositiveInt, ...] = Field(
        (64, 64),
        min_length=1,
        description="widths of the terrain layers; not given in the paper [-]",
    )
    fused: int = Field(128, ge=1, le=4096, description="width of S′; not given in the paper [-]")
    head: int = Field(
        128, ge=1, le=4096, description="width of each head's layer; not given in the paper [-]"
    )

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module that maps observations (B, N + 3) to Q-values (B, n_actions)."""
        from torch import nn

        from .modules import Dueling, Fusion, Normalise, perceptron

        terrain = perceptron((layout.bins, *self.terrain))
        return nn.Sequential(
            Normalise(layout),
            Fusion(layout, terrain, self.terrain[-1], self.fused),
            Dueling(self.fused, self.head, n_actions),
        )
