"""Ground as the tracks feel it: fine recordings thinned, and bounds on what is simulated.

In: a profile as a terrain gave it. Out: a profile that feels the same and is cheap to drive on.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Profile

TOLERANCE = 1e-4
"""How far thinning may move the ground that a track feels [m].

As much as the engine lets bodies in contact overlap (``collision_slop``): less cannot be felt.
"""

FINE = 0.01
"""Only a point whose two neighbours are less than this apart in x may be left out [m].

A vertical face at least this high keeps both its ends.
"""

FEW = 1000
"""A profile with at most this many points is driven on as it is."""

MOST = 50_000
"""Points that may be left: 250 m of ground at 5 mm, for which a reset takes a second."""

LONGEST = 2000.0
"""Of an outline [m]: almost three hours of driving at 0.2 m/s."""


def thinned(profile: Profile, track_radius: float) -> Profile:
    """Return the profile without points that a track of this radius [m] cannot feel.

    A point is left out if it lies within ``TOLERANCE`` of the line that takes its place, or in a
    hollow so narrow that the round end sinks into it by less than ``TOLERANCE``: on two edges d
    apart it sinks by d²/8r, which gives d = 9 mm at a radius of 0.1 m. First and last point and
    all ground that is not fine stay as they are; without anything to leave out the profile
    itself is returned.
    """
    if len(profile.points) <= FEW:
        return profile
    from flipperctl.sim.thinning import kept_points  # numba takes a third of a second to import

    span = math.sqrt(8 * track_radius * TOLERANCE)
    keep = kept_points(profile.points, _fixed(profile.points), TOLERANCE, span)
    return profile if keep.all() else Profile(profile.points[keep], profile.label)


def check_extent(profile: Profile) -> None:
    """Refuse ground that would take more time and memory than any drive is worth.

    Raises:
        ValueError: the profile has too many points or is too long.
    """
    if (count := len(profile.points)) > MOST:
        raise ValueError(
            f"the profile has {count} points after thinning to {TOLERANCE * 1000:g} mm; at most "
            f"{MOST} are allowed: cut it or sample it more coarsely"
        )
    with np.errstate(over="ignore"):  # what overflows is too long
        length = float(np.hypot(*np.diff(profile.points, axis=0).T).sum())
    if length > LONGEST:
        raise ValueError(
            f"the profile's outline is {length:.4g} m long; at most {LONGEST:g} m are allowed "
            "(is its unit metres?)"
        )


def _fixed(points: FloatArray) -> NDArray[np.bool_]:
    """Points that thinning must not leave out, (V,)."""
    x, z = points.T
    fixed = np.ones(len(points), dtype=np.bool_)
    fixed[1:-1] = x[2:] - x[:-2] >= FINE
    # Runs of equal x are vertical faces.
    begins = np.flatnonzero(np.concatenate([[True], np.diff(x) > 0]))
    ends = np.append(begins[1:], len(x)) - 1
    faces = np.abs(z[ends] - z[begins]) >= FINE
    fixed[begins[faces]] = fixed[ends[faces]] = True
    return fixed
