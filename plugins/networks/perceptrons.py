"""Plain perceptrons, for comparison; torch is imported only when one is built."""

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


@network("dueling_mlp")
class DuelingMlp(Network):
    """One perceptron over all N + 3 observations, with dueling heads (Wang et al. 2016)."""

    hidden: tuple[PositiveInt, ...] = Field(
        (128, 128), min_length=1, description="widths of the hidden layers [-]"
    )
    head: int = Field(128, ge=1, le=4096, description="width of each head's layer [-]")

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module that maps observations (B, N + 3) to Q-values (B, n_actions)."""
        from torch import nn

        from .modules import Dueling, Normalise, perceptron

        return nn.Sequential(
            Normalise(layout),
            perceptron((layout.size, *self.hidden)),
            Dueling(self.hidden[-1], self.head, n_actions),
        )
