"""Heights of the ground ahead of the robot and below it, from the observation alone.

Rules that learn their numbers decide by them, since recorded drives hold no points.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import ObservationLayout, RobotGeometry

Rows = tuple[tuple[float, ...], ...]


class Ground(NamedTuple):
    """Heights of the ground above the ground on which a level robot stands [m]."""

    lowest: float
    """Lowest mean of the bins ahead of the chassis, as far as a flipper reaches."""
    highest: float
    """Highest point of these bins."""
    rear_lowest: float
    """Lowest mean of the bins below the rear half of the chassis."""
    rear_highest: float
    """Highest point of these bins."""


def ground(
    observation: NDArray[np.float32], layout: ObservationLayout, robot: RobotGeometry
) -> Ground:
    """Return the heights of the ground; where no bin lies in a range, the outermost one counts."""
    n, half = layout.bins, robot.chassis_length / 2
    x = (np.arange(n) + 0.5) * layout.bin_width - layout.reach  # centres of the bins, (N,) [m]
    mean = observation[:n].astype(np.float64) + robot.track_radius
    top = observation[n : 2 * n] + robot.track_radius if layout.highest else mean
    ahead = np.flatnonzero((x >= half) & (x <= half + robot.flipper_axle))
    below = np.flatnonzero((x >= -half) & (x <= 0))
    ahead, below = ahead if ahead.size else np.array([n - 1]), below if below.size else ahead * 0
    parts = mean[ahead].min(), top[ahead].max(), mean[below].min(), top[below].max()
    return Ground(*map(float, parts))


def table(rows: Sequence[Sequence[float]], digits: int) -> Rows:
    """Return rows of rounded numbers."""
    return tuple(tuple(round(float(value), digits) for value in row) for row in rows)
