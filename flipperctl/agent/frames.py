"""What a network sees: the newest observations of an episode, side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import Network, ObservationLayout


def input_size(network: Network, layout: ObservationLayout) -> int:
    """Numbers that the network takes: frames · (N + 3)."""
    return network.frames * layout.size


def stacked(recent: Sequence[NDArray[np.float32]], frames: int) -> NDArray[np.float32]:
    """The newest ``frames`` observations in a row, oldest first: (frames · (N + 3),).

    ``recent``: observations of one episode, newest last. At its start the first stands in for
    those that there are not.
    """
    if frames == 1:
        return recent[-1]
    newest = recent[-frames:]
    return np.concatenate([*[newest[0]] * (frames - len(newest)), *newest])
