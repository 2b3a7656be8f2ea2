"""Strips of a recorded surface along the line of its profile.

In: a profile with its surface, and the borders between strips. Out: each strip's outline, that of
the surface at the middle of the strip. Strips are narrow where the robot drives and wide beside it,
where a steered robot never drives. Tracks that touch many strips have as many contacts, which makes
them stiffer: over ground that is the same on both sides, strips of 0.1 m change the time by up to
4 %, those of 0.2 m by less than 1 %.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Profile, Surface
from flipperctl.errors import PluginFailedError, TerrainError
from flipperctl.sim.mujoco.settings import MujocoSettings

CLOSE = 1e-6
"""Borders closer than this are one, since sums of widths are rounded [m]."""
LEVEL_GROUND = 20.0
"""Length of the level ground before and past the profile [m]."""
_RAMP = 0.2
"""Length in which level ground beside the line rises to the surface's first heights [m].

The robot's front flippers end 0.28 m before the first edge when it starts.
"""
_TOLERANCE = 1e-3
"""Largest distance by which straight parts may differ from the recorded ground [m].

Contacts are so soft that tracks sink in by about as much, and half as many boxes are left.
"""
_MARGIN = 0.15  # narrow strips beside the robot [m]
_WIDE = 0.5  # largest width of the strips farther away [m]


class Strip(NamedTuple):
    """A part of the ground along x that is constant over its width."""

    low: float
    """Its right border's y [m]."""
    high: float
    """Its left border's y [m]."""
    line: FloatArray
    """Its outline, level ground before and past it included, (V, 2) of x and z [m]."""


def reach(sim: MujocoSettings) -> float:
    """Return the largest distance of the robot's tracks from the line at the start [m]."""
    return sim.flipper_offset + sim.track_width / 2 + sim.offset


def surface_borders(sim: MujocoSettings) -> set[float]:
    """Return the borders between the strips of a surface, as y [m]."""
    count = math.ceil((reach(sim) + _MARGIN) / sim.strip_width)
    narrow = count * sim.strip_width
    wide = np.arange(narrow, sim.ground_width / 2, _WIDE)
    positive = [*(sim.strip_width * k for k in range(count)), *wide.tolist()]
    return {y * sign for y in positive for sign in (-1.0, 1.0)}


def surface_strips(
    profile: Profile, surface: Surface, borders: list[float], kept: list[float], sim: MujocoSettings
) -> list[Strip]:
    """Return the strips between ascending borders.

    Equal neighbours are one, except at the borders ``kept``.

    Raises:
        TerrainError: the surface cannot be read, or is unknown where the robot drives.
        PluginFailedError: the surface returned an array of another shape.
    """
    middles = np.array([(low + high) / 2 for low, high in pairwise(borders)])
    try:
        heights = surface.heights(middles)
    except ValueError as error:
        raise TerrainError(f"sim=mujoco: {error}") from error
    if heights.shape != (allowed := (len(surface.x), len(middles))):
        raise PluginFailedError(
            f"{type(surface).__name__}.heights returned an array of the shape {heights.shape}; "
            f"{allowed} is allowed"
        )
    nearest = np.array([max(low, -high, 0.0) for low, high in pairwise(borders)])
    driven = nearest < reach(sim)
    _check(surface.x, middles, heights, driven, reach(sim))
    heights = _continued(heights, middles)
    found: list[Strip] = []
    for (low, high), column in zip(pairwise(borders), heights.T, strict=True):
        line = _outline(profile, surface.x, column)
        free = all(abs(low - border) > CLOSE for border in kept)
        if found and free and np.array_equal(found[-1].line, line):
            low, line = found.pop().low, line
        found.append(Strip(low, high, line))
    return found


def _check(
    x: FloatArray, y: FloatArray, heights: FloatArray, driven: NDArray[np.bool_], within: float
) -> None:
    unknown = ~np.isfinite(heights) & driven
    if unknown.any():
        i, j = np.argwhere(unknown)[0]
        side = "left" if y[j] > 0 else "right"
        raise TerrainError(
            f"sim=mujoco: the ground is unknown {x[i]:.2f} m along the line and {abs(y[j]):.2f} m "
            f"to its {side}, in a hole or outside the recording; the robot needs "
            f"{within:.2f} m to each side: move the line, or raise the terrain's largest_gap"
        )


def _continued(heights: FloatArray, y: FloatArray) -> FloatArray:
    """Return the heights (X, Y), where unknown those of the next strip towards the line."""
    known = heights.copy()
    for j in np.argsort(np.abs(y), kind="stable"):
        inward = j - 1 if y[j] > 0 else j + 1
        if 0 <= inward < len(y):
            known[:, j] = np.where(np.isfinite(known[:, j]), known[:, j], known[:, inward])
    return known


def _outline(profile: Profile, x: FloatArray, z: FloatArray) -> FloatArray:
    """Return a strip's outline: level as the line before and past it, without straight points."""
    from flipperctl.sim.thinning import kept_points  # numba takes a third of a second to import

    points = np.column_stack([x, z])
    keep = kept_points(points, np.zeros(len(points), dtype=np.bool_), _TOLERANCE, 0.0)
    first, last = profile.points[0], profile.points[-1]
    return np.vstack(
        [
            [first[0] - LEVEL_GROUND, first[1]],
            [first[0] - _RAMP, first[1]],
            points[keep],
            [last[0] + _RAMP, last[1]],
            [last[0] + LEVEL_GROUND, last[1]],
        ]
    )
