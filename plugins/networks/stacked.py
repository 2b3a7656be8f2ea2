"""A network whose input is the last few observations and chosen earlier ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import Field, PositiveInt

from flipperctl.api import MAX_HISTORY, Network, ObservationLayout, network

if TYPE_CHECKING:
    import torch


@network("stacked")
class Stacked(Network):
    """AT-D3QN over a window of observations, which show how the robot is moving.

    The changes between the last observations enter the fusion layer with the robot's own angles.
    """

    window: int = Field(
        3, ge=2, le=16, description="number of observations seen at once, newest included [-]"
    )
    earlier: tuple[Annotated[int, Field(ge=2, le=MAX_HISTORY - 1)], ...] = Field(
        (),
        description="ages of further observations in decisions, counted from the newest one; they "
        "distinguish a robot that has stood for long from one that has just stopped [-]",
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
        description="fraction of each layer's outputs that an update sets to 0 at random, against "
        "overfitting to labels [-]",
    )

    @property
    def frames(self) -> int:
        """Number of observations in an input row, back to the earliest one used [-]."""
        return max([self.window, *(lag + 1 for lag in self.earlier)])

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module that maps (B, frames · (N + 3)), oldest first, to Q (B, n_actions)."""
        from torch import nn

        from .modules import (
            Dueling,
            Fusion,
            Motion,
            Normalise,
            perceptron,
        )

        dropout = self.dropout
        terrain = perceptron((layout.bins, *self.terrain), dropout=dropout)
        seen = sorted({*range(self.window), *self.earlier}, reverse=True)
        changes = (len(seen) - 1) * layout.size
        return nn.Sequential(
            Normalise(layout, self.frames),
            Motion([self.frames - 1 - lag for lag in seen], self.frames, layout.size),
            Fusion(layout, terrain, self.terrain[-1], self.fused, changes, dropout),
            Dueling(self.fused, self.head, n_actions, dropout=dropout),
        )
