"""torch modules that the built-in networks are made of; imported only inside ``build``."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import nn

from flipperctl.api import ObservationLayout

SLOPE = 0.01
"""Of the Leaky ReLU on the negative side."""


class Normalise(nn.Module):
    """Divides each number by its typical magnitude, (B, N + 3) SI → (B, N + 3) of order one."""

    scale: torch.Tensor

    def __init__(self, layout: ObservationLayout) -> None:
        super().__init__()
        self.register_buffer("scale", torch.tensor(layout.scale, dtype=torch.float32))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """(B, N + 3) → (B, N + 3)."""
        return observation / self.scale


def perceptron(sizes: Sequence[int]) -> nn.Sequential:
    """Linear layers of the given widths, each followed by a Leaky ReLU."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.LeakyReLU(SLOPE)]
    return nn.Sequential(*layers)


class Dueling(nn.Module):
    """Value and advantage heads: Q = V + A - mean A (Wang et al. 2016, Eq. 9)."""

    def __init__(self, features: int, hidden: int, n_actions: int) -> None:
        super().__init__()
        self.value = nn.Sequential(perceptron((features, hidden)), nn.Linear(hidden, 1))
        self.advantage = nn.Sequential(perceptron((features, hidden)), nn.Linear(hidden, n_actions))

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """(B, features) → (B, n_actions)."""
        advantage = self.advantage(features)
        q: torch.Tensor = self.value(features) + advantage - advantage.mean(dim=1, keepdim=True)
        return q


class Fusion(nn.Module):
    """Terrain features joined with the robot's own angles (paper Fig. 4, left)."""

    def __init__(self, layout: ObservationLayout, terrain: Sequence[int], fused: int) -> None:
        super().__init__()
        self.bins = layout.bins
        self.terrain = perceptron((layout.bins, *terrain))
        self.joined = perceptron((terrain[-1] + 3, fused))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """(B, N + 3) → S′ (B, fused)."""
        heights, robot = observation[:, : self.bins], observation[:, self.bins :]
        features: torch.Tensor = self.joined(torch.cat([self.terrain(heights), robot], dim=1))
        return features
