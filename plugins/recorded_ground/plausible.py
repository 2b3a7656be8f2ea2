"""Remarks on recorded ground that a wrong unit or frame may explain.

In: extents and a profile [m]. Out: sentences for the user.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray

from .geotiff import SAME_LENGTH
from .layers import Choice, Ground
from .line import Line

LARGE = 1000.0
"""Extent above which the unit may be wrong [m]."""
_SMALL = 0.1
"""Length of a line below which the unit may be wrong, or the coordinates degrees [m]."""
_HIGH = 1.0
"""Height of a vertical face above which the unit may be wrong [m]."""
_STEEP = 5.0
"""Smallest slope at which sampled ground counts as a vertical face: 79° [-]."""


def remarks_on_extent(extent: FloatArray, remedy: str) -> Iterator[str]:
    """Yield a remark on an extent (x, y, z) or (x, z) that is large [m]."""
    if (extent > LARGE).any():
        sides = " by ".join(f"{side:g}" for side in extent)
        yield f"it covers {sides} m, more than 1 km; {remedy}"


def remarks_on_profile(points: FloatArray, remedy: str, layered: bool) -> Iterator[str]:
    """Yield remarks on the points of a profile, (V, 2) of x and z [m].

    ``layered``: the file may hold surfaces above each other.
    """
    length = float(np.ptp(points[:, 0]))
    if 0 < length < _SMALL:
        yield (
            f"the line is {length:.3g} m long; {remedy}, and coordinates in degrees need a "
            "projection to metres"
        )
    height, x = highest_face(points)
    if height > _HIGH:
        if layered:
            remedy += ", or no ground was found there below something overhead"
        yield f"a face at x = {x:.2f} m is {height:.4g} m high, more than 1 m; {remedy}"


def remarks_on_projection(line: Line) -> Iterator[str]:
    """Yield a remark if a metre of the frame is not a metre of the ground along the line."""
    scale = line.length / float(np.hypot(*np.subtract(line.end, line.start)))
    if abs(scale - 1) > SAME_LENGTH:
        yield (
            f"1 m of its projection is {scale:.3f} m of ground along the line; start and end are "
            "in metres of the projection, the profile and spacing in metres of the ground"
        )


def remarks_on_layers(
    ground: Ground, choice: Choice, hanging: NDArray[np.bool_] | None = None
) -> Iterator[str]:
    """Yield remarks on surfaces above each other at places along the line, (D,).

    ``hanging``: where only something overhead was measured, (D,).
    """
    covered, doubtful = ground.covered, ground.doubtful
    # Single places are left out: there, two sheets that form a step meet.
    same = np.append(ground.raised[1:] & ground.raised[:-1], False)
    raised = same | np.roll(same, 1)
    if covered.any():
        taken, other = ("highest", "false takes the lowest")
        if not choice.highest:
            taken, other = ("lowest", "true takes the highest")
        yield (
            f"something lies {choice.headroom:g} m or more above the ground at "
            f"{int(covered.sum())} of {len(covered)} places along the line, as a ceiling or a "
            f"bridge does; the {taken} layer is taken (terrain.highest={other})"
        )
    if hanging is not None and hanging.any():
        yield (
            f"only something {choice.headroom:g} m or more above the ground beside it was measured "
            f"at {int(hanging.sum())} of {len(hanging)} places along the line; the ground is "
            "interpolated there (terrain.largest_gap)"
        )
    if raised.any() and not choice.highest:
        yield (
            f"something lies less than {choice.headroom:g} m above a lower surface at "
            f"{int(raised.sum())} of {len(raised)} places along the line; the robot drives on the "
            f"upper one there (terrain.headroom={choice.headroom:g} is set, a smaller one lets it "
            "drive below)"
        )
    if doubtful.any() and not choice.highest:
        yield (
            f"at {int(doubtful.sum())} of {len(doubtful)} places along the line a face may lie in "
            "a body that is not closed; it is not used as ground"
        )


def remarks_on_missing(heights: FloatArray) -> Iterator[str]:
    """Yield a remark if heights of a map along the line, (D,) [m], are unknown (NaN)."""
    if count := int(np.isnan(heights).sum()):
        yield (
            f"heights are missing at {count} of {len(heights)} places along the line; they are "
            "interpolated between their neighbours (terrain.largest_gap)"
        )


def highest_face(points: FloatArray) -> tuple[float, float]:
    """Return the height of the highest vertical face and its place [m]."""
    dx, dz = np.diff(points, axis=0).T
    steep = np.abs(dz) > _STEEP * dx
    rises = np.where(steep, dz, 0.0)
    sign = np.sign(rises)
    run = np.cumsum(np.append(True, sign[1:] != sign[:-1])) - 1
    heights = np.abs(np.bincount(run, weights=rises))
    highest = int(heights.argmax())
    return float(heights[highest]), float(points[int(np.argmax(run == highest)), 0])
