"""A network that convolves over the terrain bins."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from pydantic import Field, PositiveInt

from flipperctl.api import Network, ObservationLayout, network

if TYPE_CHECKING:
    import torch


@network("conv")
class Conv(Network):
    """AT-D3QN with 1-D convolutions as terrain layers, which detect edges equally in all bins."""

    channels: tuple[PositiveInt, ...] = Field(
        (16, 16), min_length=1, description="channels of the convolutions [-]"
    )
    reach: int = Field(
        1, ge=0, le=7, description="bins to either side that a convolution covers [-]"
    )
    fused: int = Field(128, ge=1, le=4096, description="width of S′ [-]")
    head: int = Field(128, ge=1, le=4096, description="width of each head's layer [-]")

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module that maps observations (B, N + 3) to Q-values (B, n_actions)."""
        from torch import nn

        from .modules import SLOPE, Dueling, Fusion, Normalise

        layers: list[nn.Module] = [nn.Unflatten(1, (1, layout.bins))]
        for inputs, outputs in pairwise((1, *self.channels)):
            # The padding continues the ground level beyond the outermost bins.
            layers += [
                nn.ReplicationPad1d(self.reach),
                nn.Conv1d(inputs, outputs, 2 * self.reach + 1),
                nn.LeakyReLU(SLOPE),
            ]
        terrain = nn.Sequential(*layers, nn.Flatten())
        return nn.Sequential(
            Normalise(layout),
            Fusion(layout, terrain, self.channels[-1] * layout.bins, self.fused),
            Dueling(self.fused, self.head, n_actions),
        )
