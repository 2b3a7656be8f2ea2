"""Find points that no ray has measured, and coordinates that were rounded when they were saved.

In: the points of a cloud as its file holds them. Out: the measured points, and remarks.
"""

import numpy as np

from flipperctl.api import FloatArray

_FEWEST, _OFTEN = 10, 10
"""Smallest number of equal points that are unmeasured, away from the origin, and its smallest ratio
to the repetitions of other points [-]."""
_FILLED = 3
"""Smallest number of points for each value of a rounded coordinate [-]."""
_SHARED = 2
"""Smallest number of points for each place in the plane, if both coordinates are rounded [-]."""
_FAR = 100
"""Smallest ratio of a coordinate to its extent that is far from the origin [-]."""


def without_unmeasured(points: FloatArray) -> tuple[FloatArray, str]:
    """Return the finite points (P, 3) that were measured, and a remark on those left out.

    Drivers store rays without return as 0 0 0, and a registration moves these to the place of the
    sensor. Points are left out that are equal far more often than others, or, at 0 0 0, more often
    at all. One point at the origin is kept.
    """
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return points, ""
    points = points[np.lexsort(points.T)]
    begins = np.append(True, (np.diff(points, axis=0) != 0).any(axis=1))
    places = points[begins]
    counts = np.diff(np.append(np.flatnonzero(begins), len(points)))
    origin = (places == 0).all(axis=1)
    others = counts[~origin]
    usual = np.quantile(others, 0.99, method="lower") if len(others) else 1
    left_out = (counts >= _FEWEST) & (counts > _OFTEN * usual) | origin & (counts > usual)
    if not left_out.any():
        return points, ""
    most = places[np.argmax(np.where(left_out, counts, 0))]
    where = " ".join(f"{value + 0.0:g}" for value in most)
    more = f" and {int(left_out.sum()) - 1} other places" if left_out.sum() > 1 else ""
    return points[np.repeat(~left_out, counts)], (
        f"{int(counts[left_out].sum())} points lie exactly at {where}{more}, as rays without return"
        " are stored; they are left out"
    )


def remark_on_rounding(
    points: FloatArray, level: str, single: bool, unit: float, spacing: float
) -> str:
    """Return a remark if coordinates are rounded to more than half the ``spacing`` [m], else "".

    ``points``, (P, 3) in a ``unit`` [m], are finite; their axes ``level``, such as "xy", are level.
    ``single``: they are stored in single precision. A regular grid is not rounded.
    """
    coarse = spacing / 2 / unit * (1 + 1e-9)
    exact, filled, far = dict[str, float](), dict[str, float](), False
    columns = dict(zip("xyz", points.T, strict=True)) if len(points) else {}
    for axis, column in columns.items():
        values = np.unique(column)
        apart, largest = np.diff(values), np.abs(values).max()
        digit = float(np.spacing(np.float32(largest)))
        step = float(np.median(apart)) if len(apart) else 0.0
        if single and digit > coarse and len(apart) and apart.min() <= digit:
            exact[axis] = digit
        elif axis in level and step > coarse and len(values) * _FILLED <= len(column):
            filled[axis], far = step, far or bool(largest > _FAR * np.ptp(values))
    if len(filled) == 2:
        places = np.unique(np.column_stack([columns[axis] for axis in filled]), axis=0)
        far = len(places) * _SHARED <= len(points)
    steps = {**exact, **(filled if far else {})}
    if not steps:
        return ""
    found = " and ".join(f"{axis} to {steps[axis] * unit:.3g} m" for axis in sorted(steps))
    return (
        f"its coordinates are rounded ({found}), as single precision far from the origin or few "
        "digits do; save them in double precision or nearer to the origin"
    )
