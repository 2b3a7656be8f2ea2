"""How far the heights of the map may be from the truth.

In: the ground along the robot, which parts of it fill gaps, and how far the robot has moved since
it saw them. Out: a standard deviation for each bin.

The errors that count are not those of single points, whose mean over a bin errs by less than a
millimetre. The pose of a scan errs: by its tilt, with the distance; by odometry, with the way since
the ground was seen; and along the way, which moves edges into other bins. Where ground was not
seen, what fills it may be anywhere between the levels on both sides, or deeper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import observation
from flipperctl.core.arrays import FloatArray

_DRIFT = {"belts": 0.15, "matched": 0.02}
"""Standard deviation of the motion by odometry, per way, over the kinds of ground that
``python -m benchmarks.odometry`` drives on [-]."""


@dataclass(frozen=True)
class Accuracy:
    """Standard deviations of what makes heights err."""

    height: float = 0.004
    """Of all heights, from biased distances and points that are no ground [m]."""
    along: float = 0.012
    """Of the place of edges along the way, half a cell of the map [m]."""
    tilt: float = 0.0
    """Of roll and pitch [rad]."""
    drift: float = 0.0
    """Of the odometry, per way [-]."""
    climb: float = 0.3
    """Of the height by odometry, in parts of ``drift``, since scans correct it [-]."""
    filled: float = 0.3
    """Of filled ground, per length that is filled; the slope from an edge to what lies unseen
    behind it [-]."""


def accuracy_of(pose: str, range_bias: float, tilt: float) -> Accuracy:
    """Return the accuracy with odometry by ``pose``, ``true``, ``belts`` or ``matched``.

    ``range_bias``: largest constant error of the distances [m]; ``tilt``: standard deviation of
    roll and pitch [rad].
    """
    height = max(0.004, range_bias / 4)  # contact corrects most of the bias
    if pose == "true":
        return Accuracy(height=height)
    return Accuracy(height=height, tilt=tilt, drift=_DRIFT[pose])


def deviations(
    points: FloatArray,
    filled: NDArray[np.bool_],
    since: FloatArray,
    bin_width: float,
    accuracy: Accuracy,
    unknown: float = 0.0,
) -> FloatArray:
    """Return the standard deviation of the mean height of each bin, (N,) [m].

    It is infinite for bins without a point that was seen. ``points`` (P, 2) of the ground in
    frame L, x never decreasing, some of them ``filled`` (P,). ``since``: (N,) way that the robot
    has gone since a point of the bin was seen; ``unknown``: motion that was not measured [m].
    """
    count = len(since)
    half = observation.reach(count, bin_width)
    index = np.clip(((points[:, 0] + half) / bin_width).astype(np.int64), 0, count - 1)
    in_bin = np.bincount(index, minlength=count)
    unseen = np.bincount(index[filled], minlength=count)
    result = np.full(count, np.inf)
    seen = in_bin > unseen
    if not seen.any():
        return result
    share = unseen / np.maximum(in_bin, 1)
    steep = _steepness(points, count, bin_width)
    distance = np.abs(np.arange(count) - (count - 1) / 2) * bin_width
    drifted = accuracy.drift * np.where(seen, since, 0.0)
    along = np.sqrt(accuracy.along**2 + drifted**2 + unknown**2)
    parts = (
        accuracy.height,
        accuracy.tilt * distance,
        accuracy.climb * np.hypot(drifted, unknown),
        along * steep,
        share * (accuracy.filled * bin_width + 0.5 * steep * bin_width),
    )
    total = np.sqrt(sum(np.square(part) for part in parts))
    result[seen] = np.broadcast_to(total, count)[seen]
    return result


def _steepness(points: FloatArray, count: int, bin_width: float) -> FloatArray:
    """Return how fast the mean height of each bin changes with its place, (N,) [-].

    It is the difference of the heights at both ends of the bin divided by its width; a face at an
    end of a bin may lie in it or not, so each end is the lowest and highest ground within 2 cm.
    """
    edges = (np.arange(count + 1) - count / 2) * bin_width
    low = np.searchsorted(points[:, 0], edges - 0.02)
    high = np.maximum(np.searchsorted(points[:, 0], edges + 0.02, side="right"), low + 1)
    low, high = (np.clip(ends, 0, len(points) - 1) for ends in (low, high - 1))
    z = points[:, 1]
    ends = np.stack([z[low], z[high]])  # (2, N + 1)
    upper, lower = ends.max(axis=0), ends.min(axis=0)
    rise = np.maximum(upper[1:] - lower[:-1], upper[:-1] - lower[1:])
    return np.asarray(np.maximum(rise, 0.0) / bin_width)
