"""A plain perceptron, for comparison."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field, PositiveInt

from flipperctl.api import Network, ObservationLayout, network

if TYPE_CHECKING:
    import torch


@network("mlp")
class Mlp(Network):
    """One perceptron from all N + 3 observations to Q, as in the first DQN (Mnih et al. 2015)."""

    hidden: tuple[PositiveInt, ...] = Field(
        (128, 128), min_length=1, description="widths of the hidden layers [-]"
    )

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module that maps observations (B, N + 3) to Q-values (B, n_actions)."""
        from torch import nn

        from .modules import Normalise, perceptron

        return nn.Sequential(
            Normalise(layout),
            perceptron((layout.size, *self.hidden)),
            nn.Linear(self.hidden[-1], n_actions),
        )
