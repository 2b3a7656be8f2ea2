"""Thins finely sampled ground to what the tracks can feel, and bounds the size of the ground.

In: a generated profile. Out: a profile that feels the same to the tracks and is cheap to simulate.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Profile
from flipperctl.core import ground_map
from flipperctl.sim.jit import cached

kept_points = cached(njit)(ground_map.kept_points)


TOLERANCE = 1e-4
"""Largest distance by which thinning may move the ground that a track feels [m].

The engine lets bodies in contact overlap by as much (``collision_slop``); less cannot be felt.
"""

FINE = 0.01
"""Only a point whose two neighbours are less than this apart in x may be omitted [m].

A vertical face of at least this height keeps both ends.
"""

FEW = 1000
"""A profile with at most this number of points is not thinned."""

MOST = 50_000
"""Largest number of points after thinning: 250 m of ground at 5 mm, whose reset takes 1 s."""

LONGEST = 2000.0
"""Largest length of an outline [m], almost three hours of driving at 0.2 m/s."""


def thinned(profile: Profile, track_radius: float) -> Profile:
    """Return the profile without points that a track of this radius [m] cannot feel.

    A point is omitted if it lies within ``TOLERANCE`` of the line that replaces it, or in a hollow
    so narrow that a round end of radius r sinks into it by less than ``TOLERANCE``: between two
    edges at distance d it sinks by d²/8r, so that d = 9 mm at a radius of 0.1 m. The first and the
    last point and all ground that is not fine are kept. If no point is omitted, the profile itself
    is returned. Its surface stays as it is.
    """
    if len(profile.points) <= FEW:
        return profile

    span = math.sqrt(8 * track_radius * TOLERANCE)
    keep = kept_points(profile.points, _fixed(profile.points), TOLERANCE, span)
    if keep.all():
        return profile
    return replace(profile, points=profile.points[keep])


def check_extent(profile: Profile) -> None:
    """Check that the ground needs an acceptable amount of time and memory.

    Raises:
        ValueError: the profile has too many points or is too long.
    """
    if (count := len(profile.points)) > MOST:
        raise ValueError(
            f"the profile has {count} points after thinning to {TOLERANCE * 1000:g} mm; at most "
            f"{MOST} are allowed: cut it or sample it more coarsely"
        )
    with np.errstate(over="ignore"):  # an overflowing length is too long
        length = float(np.hypot(*np.diff(profile.points, axis=0).T).sum())
    if length > LONGEST:
        raise ValueError(
            f"the profile's outline is {length:.4g} m long; at most {LONGEST:g} m are allowed "
            "(is its unit metres?)"
        )


def _fixed(points: FloatArray) -> NDArray[np.bool_]:
    """Return which points thinning must keep, (V,)."""
    x, z = points.T
    fixed = np.ones(len(points), dtype=np.bool_)
    fixed[1:-1] = x[2:] - x[:-2] >= FINE
    # Runs of equal x are vertical faces.
    begins = np.flatnonzero(np.concatenate([[True], np.diff(x) > 0]))
    ends = np.append(begins[1:], len(x)) - 1
    faces = np.abs(z[ends] - z[begins]) >= FINE
    fixed[begins[faces]] = fixed[ends[faces]] = True
    return fixed
