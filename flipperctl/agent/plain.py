"""A network as numpy computes it, for processes that drive without torch.

In: calls that ``agent.translate`` reads from a torch module, and weights by their names. Out: the
outputs of one input row, equal to torch's up to rounding. A decision takes a fraction of torch's
time, most of which is not arithmetic for networks of this size.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from flipperctl.core.risk import EpisodeRisk, Place, RiskSign
from flipperctl.errors import NonFiniteError

Weights = Mapping[str, NDArray[Any]]
"""A network's ``state_dict`` as arrays."""


RISK: Final = ".risk."
"""Prefix of the risk network's weights beside the policy's. No weight of a policy begins with it,
since the name of a submodule is never empty."""


def split_weights(weights: Weights) -> tuple[Weights, Weights]:
    """Return the weights of the policy, and those of its risk by their own names."""
    risk = {n.removeprefix(RISK): array for n, array in weights.items() if n.startswith(RISK)}
    return {n: array for n, array in weights.items() if not n.startswith(RISK)}, risk


class Outputs(Protocol):
    """A network that drives, computed by numpy (``PlainNetwork``) or torch (``TorchNetwork``)."""

    def load(self, weights: Weights, /) -> None:
        """Take the weights of another process."""

    def begin(self, noise: bool) -> None:
        """Enter the mode of decisions, with the network's own noise if it has any and may."""

    def draw_noise(self, rng: np.random.Generator, /) -> None:
        """Draw new noise; a network without noise leaves ``rng`` alone."""

    def outputs(self, row: NDArray[np.float32], /) -> list[float]:
        """Return the Q-values (3^J,) or rates (J,) of an input row, (frames · n,) in SI units."""


def best(values: Sequence[float]) -> int:
    """Return the action with the largest Q-value, the first one of equals."""
    return values.index(max(values))


class Call(NamedTuple):
    """One operation; places count the network's input, then its constants, weights and results."""

    function: Callable[..., Any]
    arguments: tuple[int, ...]
    """Places of the arguments."""
    result: int
    """Place of the result."""


@dataclass
class PlainNetwork:
    """A network without noise, whose weights come by ``load``; see ``Outputs``."""

    calls: Sequence[Call]
    """Operations in their order; the last one returns the outputs, (1, A)."""
    constants: Mapping[int, Any]
    weights: Mapping[int, str]
    """Names of the weights by their places."""
    fault: str
    """Text of the error about outputs that are not finite."""

    def load(self, weights: Weights) -> None:
        """Take the weights of another process."""
        self._memory: dict[int, Any] = dict(self.constants)
        self._memory |= {place: weights[name] for place, name in self.weights.items()}

    def begin(self, noise: bool) -> None:
        """Do nothing: there is no other mode."""

    def draw_noise(self, rng: np.random.Generator) -> None:
        """Do nothing: there is no noise."""

    def outputs(self, row: NDArray[np.float32]) -> list[float]:
        """Return the outputs (A,) of an input row, (frames · n,)."""
        memory, result = self._memory, 0
        memory[0] = row[np.newaxis]
        for function, arguments, result in self.calls:
            memory[result] = function(*[memory[place] for place in arguments])
        values: list[float] = memory[result][0].tolist()
        if not math.isfinite(sum(values)):
            raise NonFiniteError(self.fault)
        return values


class PlainRisk:
    """The risk of a policy that no calibration has changed, see ``agent.risk.Risk``."""

    def __init__(self, network: PlainNetwork, horizon: int) -> None:
        """``network``: its layers, to log-odds and coefficients (1 + lags,)."""
        self._network, self.sign = network, RiskSign(horizon, 0.5)
        self.load = network.load

    def begin(self, size: int) -> EpisodeRisk:
        """Return what remembers a new episode; ``size``: length n of an observation."""
        return EpisodeRisk(size, self.sign)

    def of_one(
        self, observation: NDArray[np.float32], episode: EpisodeRisk, place: Place | None = None
    ) -> float:
        """Return the risk of an episode's next input row, (frames · n,)."""
        log_odds, *coefficients = self._network.outputs(observation)
        alone = math.exp(-np.logaddexp(0.0, -log_odds))
        return episode.update(alone, np.array(coefficients, np.float32), observation, place)


@dataclass(frozen=True)
class PlainNetworks:
    """What the workers of a training drive with."""

    policy: PlainNetwork
    """Takes the weights of the policy, or of what drives training episodes."""
    risk: PlainRisk | None = None


# What layers and functions of torch compute on arrays (B, …), with their arguments' names.
def linear(x: NDArray[Any], weight: NDArray[Any], bias: NDArray[Any] | None = None) -> Any:
    """Return x Wᵀ + b."""
    product: NDArray[Any] = x.dot(weight.T)
    if bias is not None:
        product += bias
    return product


def leaky_relu(x: NDArray[Any], negative_slope: float = 0.01) -> Any:
    """Return x, or its multiple by the slope where it is negative; the slope is at most 1."""
    below = x * negative_slope
    return np.maximum(x, below, out=below)


def relu(x: NDArray[Any]) -> Any:
    """Return x, or 0 where it is negative."""
    return np.maximum(x, 0)


def identity(x: NDArray[Any]) -> Any:
    """Return x."""
    return x


def pack(*parts: Any) -> tuple[Any, ...]:
    """Return a tuple of arrays, for functions that take several."""
    return parts


def cat(parts: Sequence[NDArray[Any]], dim: int = 0) -> Any:
    """Return the parts in sequence along an axis."""
    return np.concatenate(parts, axis=dim)


def mean(x: NDArray[Any], dim: int, keepdim: bool = False) -> Any:
    """Return the mean along an axis."""
    total: Any = np.add.reduce
    return total(x, axis=dim, keepdims=keepdim) / x.shape[dim]


def reshape(x: NDArray[Any], *shape: int) -> Any:
    """Return x in another shape."""
    return x.reshape(shape)


def flatten(x: NDArray[Any], start_dim: int = 0, end_dim: int = -1) -> Any:
    """Return x with the axes from ``start_dim`` to ``end_dim`` as one."""
    after = x.shape[end_dim:][1:]
    return x.reshape(*x.shape[:start_dim], -1, *after)


def unflatten(x: NDArray[Any], dim: int, sizes: Sequence[int]) -> Any:
    """Return x with the axis ``dim`` ≥ 0 as several."""
    return x.reshape(*x.shape[:dim], *sizes, *x.shape[dim + 1 :])
