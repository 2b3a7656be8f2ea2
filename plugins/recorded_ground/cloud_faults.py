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
_SHARED, _SAME_SURFACE = 0.5, 0.003
"""Smallest share of points that have another at the same place in the plane, if both coordinates
are rounded [-], and the largest difference of their heights [m]."""
_COARSER = 4
"""Smallest ratio of such rounding to the rounding that is reported far from the origin [-]."""
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
    points: FloatArray, level: str, single: bool | None, unit: float, spacing: float
) -> str:
    """Return a remark if coordinates are rounded to more than half the ``spacing`` [m], else "".

    ``points``, (P, 3) in a ``unit`` [m], are finite. ``single``: they are stored in single
    precision; None: if that holds them without loss. Other rounding is looked for along the axes
    ``level``, such as "xy", by points that share coordinates; a regular grid is not rounded.
    """
    with np.errstate(over="ignore"):
        short = points.astype(np.float32)
    single = bool((short == points).all()) if single is None else single
    coarse = spacing / 2 / unit * (1 + 1e-9)
    steps, filled, far = dict[str, float](), dict[str, float](), set[str]()
    columns = dict(zip("xyz", points.T, strict=True)) if len(points) else {}
    for axis, column in columns.items():
        values = np.unique(column)
        apart, largest = np.diff(values), np.abs(values).max()
        digit = float(np.spacing(np.abs(short[:, "xyz".index(axis)]).max()))
        if single and digit > coarse and len(apart) and apart.min() <= digit:
            steps[axis] = digit
        elif axis in level and len(values) * _FILLED <= len(column):
            filled[axis] = float(np.median(apart)) if len(apart) else 0.0
            far |= {axis} if largest > _FAR * np.ptp(values) else set()
    if len(filled) == 2:
        (height,) = {*"xyz"} - {*level}
        keys = np.column_stack([columns[axis] for axis in (height, *level)])
        apart = np.abs(np.diff(keys[np.lexsort(keys.T)], axis=0))
        shared = (apart <= (_SAME_SURFACE / unit, 0, 0)).all(axis=1)
        coarser = {axis for axis, step in filled.items() if step > _COARSER * coarse}
        far = (far or coarser) if shared.sum() >= _SHARED * len(points) else set()
    steps |= {axis: filled[axis] for axis in far if filled[axis] > coarse}
    if not steps:
        return ""
    found = " and ".join(f"{axis} to {steps[axis] * unit:.3g} m" for axis in sorted(steps))
    return (
        f"its coordinates are rounded ({found}), as single precision far from the origin or few "
        "digits do; save them in double precision or nearer to the origin"
    )
