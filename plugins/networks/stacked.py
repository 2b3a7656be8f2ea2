"""A memory of the last decisions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from flipperctl.api import Network, ObservationLayout, network

if TYPE_CHECKING:
    import torch


@network("stacked")
class Stacked(Network):
    """``dueling_mlp`` over the newest observation and how it came about: it sees what moves."""

    window: int = Field(
        4, ge=2, le=16, description="observations that are taken in at once, newest included [-]"
    )
    hidden: tuple[int, ...] = Field(
        (128, 128), min_length=1, description="widths of the hidden layers [-]"
    )
    head: int = Field(128, ge=1, le=4096, description="width in each head [-]")

    @property
    def frames(self) -> int:
        """As many as the window holds."""
        return self.window

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Observations (B, window · (N + 3)), oldest first → Q (B, n_actions)."""
        from flipperctl_plugins.networks.modules import Dueling, Motion, Normalise, perceptron
        from torch import nn

        return nn.Sequential(
            Normalise(layout, self.window),
            Motion(self.window),
            perceptron((self.window * layout.size, *self.hidden)),
            Dueling(self.hidden[-1], self.head, n_actions),
        )
