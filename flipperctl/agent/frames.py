"""The input row of a network: the newest observations of an episode, concatenated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import Network, ObservationLayout


def input_size(network: Network, layout: ObservationLayout) -> int:
    """Return the length of the network's input row, frames · n."""
    return network.frames * layout.size


def stacked(recent: Sequence[NDArray[np.float32]], frames: int) -> NDArray[np.float32]:
    """Return the newest ``frames`` observations in one row, oldest first, (frames · n,).

    ``recent``: observations of one episode, newest last. At its start the first observation is
    repeated in place of missing ones.
    """
    if frames == 1:
        return recent[-1]
    newest = recent[-frames:]
    return np.concatenate([*[newest[0]] * (frames - len(newest)), *newest])
