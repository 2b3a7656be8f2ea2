"""A network that sees the last few observations at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field, PositiveInt

from flipperctl.api import Network, ObservationLayout, network

if TYPE_CHECKING:
    import torch


@network("stacked")
class Stacked(Network):
    """AT-D3QN over a window of observations, from which it can tell how the robot is moving.

    The changes between the last observations enter the fusion layer with the robot's own angles.
    """

    window: int = Field(
        3, ge=2, le=16, description="number of observations seen at once, newest included [-]"
    )
    terrain: tuple[PositiveInt, ...] = Field(
        (64, 64), min_length=1, description="widths of the terrain layers [-]"
    )
    fused: int = Field(128, ge=1, le=4096, description="width of S′ [-]")
    head: int = Field(128, ge=1, le=4096, description="width of each head's layer [-]")
    dropout: float = Field(
        0.0,
        ge=0,
        le=0.9,
        description="fraction of each layer's numbers that an update sets to 0 at random, so that "
        "labels are not learnt by heart [-]",
    )

    @property
    def frames(self) -> int:
        """Number of stacked observations, which is the window [-]."""
        return self.window

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module that maps (B, window · (N + 3)), oldest first, to Q (B, n_actions)."""
        from torch import nn

        from .modules import (
            Dueling,
            Fusion,
            Motion,
            Normalise,
            perceptron,
        )

        lost = self.dropout
        terrain = perceptron((layout.bins, *self.terrain), dropout=lost)
        changes = (self.window - 1) * layout.size
        return nn.Sequential(
            Normalise(layout, self.window),
            Motion(self.window, layout.size),
            Fusion(layout, terrain, self.terrain[-1], self.fused, changes, lost),
            Dueling(self.fused, self.head, n_actions, dropout=lost),
        )
