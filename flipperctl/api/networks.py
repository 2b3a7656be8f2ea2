"""Q-networks, which plugins build as torch modules."""

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

    The Q-values of an observation depend on it and on the weights alone, not on earlier calls or on
    other rows, and the input is not changed. The loss is computed in ``train()`` mode: there
    layers may also draw from torch's global generator, as ``torch.nn.Dropout`` does, which is
    seeded for each update. Decisions and targets are computed in ``eval()`` mode.

    The module may have methods besides ``forward`` that change how it is trained:

    - ``quantiles(observation)`` → (B, n_actions, K): K equally likely values of each action's
      return, whose mean ``forward`` returns. They are learned by quantile regression.
    - ``draw_noise(rng: np.random.Generator)`` of the module or of any submodule samples new noise
      before each decision of training and before each update. The noise acts in ``train()`` mode
      only, in which such a part also is in decisions and targets of training; a policy is
      evaluated and exported in ``eval()`` mode. Tensors of noise are non-persistent buffers.
    """

    kind: ClassVar[str] = "network"

    @property
    def frames(self) -> int:
        """Number of the newest observations in one input row, at most ``MAX_HISTORY``.

        A row contains the N + 3 numbers of each observation, the oldest observation first. At the
        start of an episode the first observation is repeated to fill the row.
        """
        return 1

    @abstractmethod
    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module from (B, frames · (N + 3)) in SI units to Q-values (B, n_actions)."""


NetworkT = TypeVar("NetworkT", bound=Network)


def network(name: str) -> Callable[[type[NetworkT]], type[NetworkT]]:
    """Register a ``Network``; choose it with ``network=<name>``."""
    return register(Network, name)
