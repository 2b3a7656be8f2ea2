"""Q-networks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar, TypeVar

from flipperctl.api.plugin import Plugin, register
from flipperctl.api.values import ObservationLayout

if TYPE_CHECKING:
    import torch


class Network(Plugin, ABC):
    """Builds the Q-network.

    The module may offer more than ``forward``, and is then trained accordingly:

    - ``quantiles(observation)`` → (B, n_actions, K): K equally likely values of each action's
      return, of which ``forward`` gives the mean. They are learnt by quantile regression.
    - ``draw_noise(rng: np.random.Generator)``, of the module or any part of it: takes new noise,
      before each decision of training and each update. The noise acts in ``train()`` mode only; a
      policy is judged and exported in ``eval()`` mode. It lies in buffers that are not persistent.
    """

    kind: ClassVar[str] = "network"

    @property
    def frames(self) -> int:
        """How many of the newest observations the module takes in at once, at most ``MEMORY``.

        Above 1, a row is their N + 3 numbers one after the other, oldest first; at the start of an
        episode the first observation stands in for those that there are not.
        """
        return 1

    @abstractmethod
    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """A module from (B, frames · (N + 3)) in SI units to Q-values (B, n_actions)."""


NetworkT = TypeVar("NetworkT", bound=Network)


def network(name: str) -> Callable[[type[NetworkT]], type[NetworkT]]:
    """Register a ``Network``; choose it with ``network=<name>``."""
    return register(Network, name)
