"""What a network sees of the newest observations."""

import numpy as np
import pytest

from flipperctl.agent.frames import input_size, stacked
from flipperctl.api import Network, ObservationLayout
from flipperctl.config import resolver

SEEN = tuple(np.array([i, -i], np.float32) for i in range(5))


@pytest.mark.parametrize(
    ("recent", "frames", "numbers"),
    [
        (SEEN, 1, [4, -4]),
        (SEEN, 3, [2, -2, 3, -3, 4, -4]),  # oldest first
        (SEEN[1:3], 4, [1, -1, 1, -1, 1, -1, 2, -2]),  # the first stands in
        (SEEN[3:4], 2, [3, -3, 3, -3]),
    ],
)
def test_the_newest_observations_in_a_row(recent: tuple, frames: int, numbers: list[int]) -> None:
    row = stacked(recent, frames)
    assert row.dtype == np.float32
    assert row.tolist() == numbers


def test_the_size_of_what_a_network_sees() -> None:
    layout = ObservationLayout(bins=5)
    network = resolver.create("network", {"name": "stacked", "window": 3}, "network")
    assert isinstance(network, Network)
    assert input_size(network, layout) == 3 * 8
