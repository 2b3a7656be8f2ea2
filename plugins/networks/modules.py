"""torch modules that the built-in networks are composed of; imported only inside ``build``."""

import copy
import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import torch
from torch import nn

from flipperctl.api import ObservationLayout

SLOPE = 0.01
"""Slope of the Leaky ReLU for negative inputs [-]."""

Linear = Callable[[int, int], nn.Module]
"""Builds a linear layer from its number of inputs and of outputs."""


class Normalise(nn.Module):
    """Scale F observations in SI units to order one, each entry by its typical magnitude."""

    scale: torch.Tensor

    def __init__(self, layout: ObservationLayout, frames: int = 1) -> None:
        super().__init__()
        scale = torch.tensor(np.tile(layout.scale, frames), dtype=torch.float32)
        self.register_buffer("scale", scale)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Map (B, F·n) in SI units to (B, F·n) [-]."""
        return observation / self.scale

    @torch.no_grad()
    def folded_into(self, layer: nn.Linear) -> nn.Linear:
        """Return ``layer`` with this normalisation folded into its weights."""
        joined = copy.deepcopy(layer)
        joined.weight.div_(self.scale)
        return joined


class Dropout(nn.Module):
    """Set features to 0 at random while the network learns (Srivastava et al. 2014).

    The remaining features are divided by ``1 - rate``. Unlike torch's layer, it acts only where
    gradients are recorded: neither in decisions nor in targets.
    """

    def __init__(self, rate: float) -> None:
        """``rate`` is the fraction of the features that are set to 0, below 1."""
        super().__init__()
        self.rate = rate
        self._seed = 0

    def draw_noise(self, rng: np.random.Generator) -> None:
        """Draw from ``rng`` which features are set to 0."""
        self._seed = int(rng.integers(2**62))

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Map (B, n) to (B, n)."""
        if not (self.training and torch.is_grad_enabled()):
            return features
        generator = torch.Generator(features.device).manual_seed(self._seed)
        mask = torch.empty_like(features).bernoulli_(1 - self.rate, generator=generator)
        return features * mask / (1 - self.rate)


def perceptron(
    sizes: Sequence[int], linear: Linear = nn.Linear, dropout: float = 0.0
) -> nn.Sequential:
    """Return linear layers of the given widths, each followed by Leaky ReLU and ``dropout``."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [linear(inputs, outputs), nn.LeakyReLU(SLOPE)]
        if dropout:
            layers.append(Dropout(dropout))
    return nn.Sequential(*layers)


class Dueling(nn.Module):
    """Value and advantage heads: Q = V + A - mean A (Wang et al. 2016, Eq. 9)."""

    def __init__(
        self,
        features: int,
        hidden: int,
        n_actions: int,
        linear: Linear = nn.Linear,
        dropout: float = 0.0,
    ) -> None:
        super().__init__()
        widths = features, hidden
        self.value = nn.Sequential(perceptron(widths, linear, dropout), linear(hidden, 1))
        self.advantage = nn.Sequential(
            perceptron(widths, linear, dropout), linear(hidden, n_actions)
        )

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Map features (B, features) to Q-values (B, n_actions)."""
        advantage = self.advantage(features)
        q: torch.Tensor = self.value(features) + advantage - advantage.mean(dim=1, keepdim=True)
        return q

    @torch.no_grad()
    def folded(self) -> nn.Module:
        """Return an equivalent module of two linear layers, the first for both heads together.

        Heads with layers other than ``nn.Linear`` are returned unchanged.
        """
        linear = [layer for layer in self.modules() if isinstance(layer, nn.Linear)]
        if len(linear) != 4:  # a noisy layer holds two
            return self
        # Both heads' hidden units, side by side in one layer
        value, v, advantage, a = linear
        hidden = nn.Linear(value.in_features, value.out_features + advantage.out_features)
        hidden.weight.copy_(torch.cat([value.weight, advantage.weight]))
        hidden.bias.copy_(torch.cat([value.bias, advantage.bias]))
        # Q = V + A - mean A is linear in these units, so that one layer computes it.
        actions = a.out_features
        centre = torch.eye(actions) - 1 / actions  # subtracts the mean of all actions
        q = nn.Linear(hidden.out_features, actions)
        q.weight.copy_(torch.cat([v.weight.expand(actions, -1), centre @ a.weight], dim=1))
        q.bias.copy_(v.bias + centre @ a.bias)
        return nn.Sequential(hidden, nn.LeakyReLU(SLOPE), q)


class DuelingQuantiles(nn.Module):
    """A front end followed by dueling heads for K quantiles of each action's return."""

    def __init__(
        self, front: nn.Module, features: int, hidden: int, n_actions: int, count: int
    ) -> None:
        """``front`` maps (B, …) to (B, features); ``count`` is K."""
        super().__init__()
        self.front = front
        self.value = nn.Sequential(perceptron((features, hidden)), nn.Linear(hidden, count))
        self.advantage = nn.Sequential(
            perceptron((features, hidden)),
            nn.Linear(hidden, n_actions * count),
            nn.Unflatten(1, (n_actions, count)),
        )

    def quantiles(self, observation: torch.Tensor) -> torch.Tensor:
        """Return the quantiles of each action's return, (B, n_actions, K)."""
        features = self.front(observation)
        advantage = self.advantage(features)
        value = self.value(features).unsqueeze(1)  # (B, 1, K)
        z: torch.Tensor = value + advantage - advantage.mean(dim=1, keepdim=True)
        return z

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Return the Q-values (B, n_actions), which are the means of the quantiles."""
        return self.quantiles(observation).mean(dim=2)


class Fusion(nn.Module):
    """Fuse terrain features with the robot's own angles in one layer (paper Fig. 4, left)."""

    def __init__(
        self,
        layout: ObservationLayout,
        terrain: nn.Module,
        features: int,
        fused: int,
        more: int = 0,
        dropout: float = 0.0,
    ) -> None:
        """``terrain`` maps the heights to (B, features); ``more`` follow the robot's angles."""
        super().__init__()
        self.heights = layout.heights
        self.terrain = terrain
        angles = layout.size - layout.heights
        self.joined = perceptron((features + angles + more, fused), dropout=dropout)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Map (B, n + more) to S′ (B, fused)."""
        heights, robot = observation[:, : self.heights], observation[:, self.heights :]
        features: torch.Tensor = self.joined(torch.cat([self.terrain(heights), robot], dim=1))
        return features


class NoisyLinear(nn.Module):
    """A linear layer whose weights have learnt, factorised Gaussian noise in ``train()`` mode.

    w = μ + σ · f(ε_out) f(ε_in)ᵀ with f(ε) = sign(ε) √|ε| (Fortunato et al. 2018, Eqs. 9 to 11).
    """

    noise_in: torch.Tensor
    noise_out: torch.Tensor

    def __init__(self, inputs: int, outputs: int, sigma: float = 0.5) -> None:
        """``sigma`` is σ₀: each σ starts at σ₀ / √inputs."""
        super().__init__()
        self.mean = nn.Linear(inputs, outputs)
        self.sigma = nn.Linear(inputs, outputs)
        for parameter in self.sigma.parameters():
            nn.init.constant_(parameter, sigma / math.sqrt(inputs))
        self.register_buffer("noise_in", torch.randn(inputs), persistent=False)
        self.register_buffer("noise_out", torch.randn(outputs), persistent=False)

    def draw_noise(self, rng: np.random.Generator) -> None:
        """Draw new noise from ``rng``."""
        # Factorised noise: f(ε) = sign(ε) √|ε| for inputs and outputs apart
        for noise in (self.noise_in, self.noise_out):
            drawn = rng.standard_normal(len(noise), dtype=np.float32)
            noise.copy_(torch.from_numpy(np.copysign(np.sqrt(np.abs(drawn)), drawn)))

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Map (B, inputs) to (B, outputs)."""
        mean: torch.Tensor = self.mean(features)
        if not self.training:
            return mean
        noise: torch.Tensor = self.noise_out * self.sigma(features * self.noise_in)
        return mean + noise


class Motion(nn.Module):
    """Replace stacked observations by the newest one and the changes before it."""

    def __init__(self, seen: Sequence[int], frames: int, size: int) -> None:
        """``seen``: ascending indices of the F frames that are used; 0 is the oldest.

        ``size`` is n, the length of one observation.
        """
        super().__init__()
        self.seen, self.frames, self.size = list(seen), frames, size

    def forward(self, stacked: torch.Tensor) -> torch.Tensor:
        """Map (B, F·n), oldest first, to (B, len(seen)·n): the newest, then the changes."""
        frames = stacked.view(-1, self.frames, self.size)[:, self.seen]
        changes = frames[:, 1:] - frames[:, :-1]
        return torch.cat([frames[:, -1], changes.flatten(1)], dim=1)

    @torch.no_grad()
    def folded(self) -> nn.Module:
        """Return an equivalent linear layer."""
        inputs = self.frames * self.size
        layer = nn.Linear(inputs, len(self.seen) * self.size, bias=False)
        layer.weight.copy_(self(torch.eye(inputs)).T)
        return layer
