"""A memory of the last decisions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field, PositiveInt

from flipperctl.api import Network, ObservationLayout, network

if TYPE_CHECKING:
    import torch


@network("stacked")
class Stacked(Network):
    """``at_d3qn`` that also sees how the newest observation came about: what moves, and what not.

    The changes between the last observations join the robot's own angles behind the terrain layers.
    """

    window: int = Field(
        3, ge=2, le=16, description="observations that are taken in at once, newest included [-]"
    )
    terrain: tuple[PositiveInt, ...] = Field(
        (64, 64), min_length=1, description="widths of the terrain layers [-]"
    )
    fused: int = Field(128, ge=1, le=4096, description="width behind the fusion [-]")
    head: int = Field(128, ge=1, le=4096, description="width in each head [-]")

    @property
    def frames(self) -> int:
        """As many as the window holds."""
        return self.window

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Observations (B, window · (N + 3)), oldest first → Q (B, n_actions)."""
        from torch import nn

        from .modules import (
            Dueling,
            Fusion,
            Motion,
            Normalise,
            perceptron,
        )

        terrain = perceptron((layout.bins, *self.terrain))
        changes = (self.window - 1) * layout.size
        return nn.Sequential(
            Normalise(layout, self.window),
            Motion(self.window),
            Fusion(layout, terrain, self.terrain[-1], self.fused, changes),
            Dueling(self.fused, self.head, n_actions),
        )
