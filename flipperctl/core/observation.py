"""Layout of the N + 3 numbers of an observation (paper Eqs. 1 and 2).

They are N mean heights of the ground in frame L [m], from rear to front, then front and rear
flipper angle in frame R and pitch [rad]. Frame L is level with its origin at the chassis centre,
frame R is fixed to the chassis.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from flipperctl.core.arrays import FloatArray

ANGLES = ("theta_f1", "theta_f2", "theta_R")
"""Names of the angles after the heights: front flippers, rear flippers, pitch."""


def size(bins: int) -> int:
    """Return the length of an observation, N + 3 [-]."""
    return bins + len(ANGLES)


def reach(bins: int, bin_width: float) -> float:
    """Return half the length of the perceived ground [m]."""
    return bins * bin_width / 2


def edges(bins: int, bin_width: float) -> FloatArray:
    """Return the edges of the bins in frame L, from rear to front, (N + 1,) [m]."""
    return np.arange(bins + 1, dtype=np.float64) * bin_width - reach(bins, bin_width)


def scale(bins: int) -> FloatArray:
    """Return the typical magnitude of each number of an observation, (N + 3,) in SI units."""
    return np.concatenate([np.full(bins, 0.5), np.full(len(ANGLES), math.pi / 3)])


def assemble(
    heights: FloatArray, *, front: float, rear: float, pitch: float
) -> NDArray[np.float32]:
    """Return an observation, (N + 3,) in SI units.

    ``heights``: mean height of each bin in frame L, (N,) [m]; ``front``, ``rear``: angles of the
    flippers in frame R, above the chassis positive [rad]; ``pitch``: nose up positive [rad].
    """
    found = np.empty(size(len(heights)), dtype=np.float32)
    found[: len(heights)] = heights
    found[len(heights) :] = front, rear, pitch
    return found


def to_level(points: FloatArray, pitch: float) -> FloatArray:
    """Transform points (P, 2) [m] from frame R to frame L at this pitch [rad]."""
    cos, sin = math.cos(pitch), math.sin(pitch)
    x, z = points.T
    return np.column_stack([cos * x - sin * z, sin * x + cos * z])
