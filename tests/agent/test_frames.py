"""The input row of a network against rows worked by hand."""

import numpy as np
import pytest

from flipperctl.agent.frames import input_size, stacked
from flipperctl.api import Network, ObservationLayout
from flipperctl.config import resolver

OBSERVATIONS = tuple(np.array([i, -i], np.float32) for i in range(5))


@pytest.mark.parametrize(
    ("recent", "frames", "numbers"),
    [
        (OBSERVATIONS, 1, [4, -4]),
        (OBSERVATIONS, 3, [2, -2, 3, -3, 4, -4]),  # oldest first
        (OBSERVATIONS[1:3], 4, [1, -1, 1, -1, 1, -1, 2, -2]),  # the first is repeated
        (OBSERVATIONS[3:4], 2, [3, -3, 3, -3]),
    ],
)
def test_the_newest_observations_in_a_row(recent: tuple, frames: int, numbers: list[int]) -> None:
    row = stacked(recent, frames)
    assert row.dtype == np.float32
    assert row.tolist() == numbers


def test_the_size_of_a_network_s_input_row() -> None:
    layout = ObservationLayout(bins=5)
    network = resolver.create("network", {"name": "stacked", "window": 3}, "network")
    assert isinstance(network, Network)
    assert input_size(network, layout) == 3 * 8
