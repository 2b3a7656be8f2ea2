"""The paper's network, further ones that fuse terrain and robot as it does, and perceptrons."""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated

from pydantic import Field, PositiveInt

from flipperctl.api import MAX_HISTORY, Network, ObservationLayout, network

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
        """Return a module that maps observations (B, n) to Q-values (B, n_actions)."""
        from torch import nn

        from .modules import Dueling

        front = self._front(layout)
        return nn.Sequential(*front, Dueling(self.fused, self.head, n_actions))

    def _front(self, layout: ObservationLayout) -> list[torch.nn.Module]:
        """Return the layers from observations (B, n) to S′ (B, fused)."""
        from .modules import Fusion, Normalise, perceptron

        terrain = perceptron((layout.heights, *self.terrain))
        return [Normalise(layout), Fusion(layout, terrain, self.terrain[-1], self.fused)]


@network("noisy")
class Noisy(AtD3qn):
    """AT-D3QN with noisy heads (Fortunato et al. 2018), which explore without ε.

    Train it with ``agent.epsilon_start=0 agent.epsilon_end=0``.
    """

    noise: float = Field(
        0.5, gt=0, le=10, description="σ₀; the noise starts with a deviation of σ₀ / √inputs [-]"
    )

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module that maps observations (B, n) to Q-values (B, n_actions)."""
        from torch import nn

        from .modules import Dueling, NoisyLinear

        linear = partial(NoisyLinear, sigma=self.noise)
        front = self._front(layout)
        return nn.Sequential(*front, Dueling(self.fused, self.head, n_actions, linear))


@network("quantile")
class Quantile(AtD3qn):
    """AT-D3QN whose heads give quantiles of each action's return (Dabney et al. 2018)."""

    quantiles: int = Field(32, ge=1, le=512, description="K, number of quantiles per action [-]")

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module that maps observations (B, n) to Q-values (B, n_actions)."""
        from torch import nn

        from .modules import DuelingQuantiles

        front = nn.Sequential(*self._front(layout))
        return DuelingQuantiles(front, self.fused, self.head, n_actions, self.quantiles)


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
        """Return a module that maps (B, frames · n), oldest first, to Q (B, n_actions)."""
        from torch import nn

        from .modules import Dueling, Fusion, Motion, Normalise, perceptron

        terrain = perceptron((layout.heights, *self.terrain), dropout=self.dropout)
        seen = sorted({*range(self.window), *self.earlier}, reverse=True)
        # As many changes as observations beside the newest one
        changes = (len(seen) - 1) * layout.size
        return nn.Sequential(
            Normalise(layout, self.frames),
            Motion([self.frames - 1 - lag for lag in seen], self.frames, layout.size),
            Fusion(layout, terrain, self.terrain[-1], self.fused, changes, self.dropout),
            Dueling(self.fused, self.head, n_actions, dropout=self.dropout),
        )


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
        """Return a module that maps observations (B, n) to Q-values (B, n_actions)."""
        from torch import nn

        from .modules import SLOPE, Dueling, Fusion, Normalise

        kinds = layout.heights // layout.bins
        layers: list[nn.Module] = [nn.Unflatten(1, (kinds, layout.bins))]
        for inputs, outputs in pairwise((kinds, *self.channels)):
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


@network("mlp")
class Mlp(Network):
    """One perceptron from all n numbers to Q, as in the first DQN (Mnih et al. 2015)."""

    hidden: tuple[PositiveInt, ...] = Field(
        (128, 128), min_length=1, description="widths of the hidden layers [-]"
    )

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module that maps observations (B, n) to Q-values (B, n_actions)."""
        from torch import nn

        from .modules import Normalise, perceptron

        return nn.Sequential(
            Normalise(layout),
            perceptron((layout.size, *self.hidden)),
            nn.Linear(self.hidden[-1], n_actions),
        )


@network("dueling_mlp")
class DuelingMlp(Network):
    """One perceptron over all n numbers, with dueling heads (Wang et al. 2016)."""

    hidden: tuple[PositiveInt, ...] = Field(
        (128, 128), min_length=1, description="widths of the hidden layers [-]"
    )
    head: int = Field(128, ge=1, le=4096, description="width of each head's layer [-]")

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module that maps observations (B, n) to Q-values (B, n_actions)."""
        from torch import nn

        from .modules import Dueling, Normalise, perceptron

        return nn.Sequential(
            Normalise(layout),
            perceptron((layout.size, *self.hidden)),
            Dueling(self.hidden[-1], self.head, n_actions),
        )
