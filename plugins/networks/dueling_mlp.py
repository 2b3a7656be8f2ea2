"""Dueling heads without the fusion front end, for comparison."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field, PositiveInt

from flipperctl.api import Network, ObservationLayout, network

if TYPE_CHECKING:
    import torch


@network("dueling_mlp")
class DuelingMlp(Network):
    """All N + 3 numbers through one perceptron into dueling heads (Wang et al. 2016)."""

    hidden: tuple[PositiveInt, ...] = Field(
        (128, 128), min_length=1, description="widths of the hidden layers [-]"
    )
    head: int = Field(128, ge=1, le=4096, description="width in each head [-]")

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Observation (B, N + 3) → Q (B, n_actions)."""
        from torch import nn

        from .modules import Dueling, Normalise, perceptron

        return nn.Sequential(
            Normalise(layout),
            perceptron((layout.size, *self.hidden)),
            Dueling(self.hidden[-1], self.head, n_actions),
        )
