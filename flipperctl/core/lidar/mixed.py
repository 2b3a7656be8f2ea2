"""Mixed returns: points between an edge and what lies behind it, which no surface is at.

In: a scan. Out: the scan without them. A pulse that meets two surfaces returns from between them;
on the map such points fill the shadow of an edge with ground that is not there.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from flipperctl.core.arrays import FloatArray
from flipperctl.core.lidar.messages import Scan

_STEEP = 1.5
"""Slope to both neighbours above which a point may be mixed: the tangent of the angle of incidence
on a plane through both [-]."""
_BEND = 1.5
"""Difference of that slope to the next one on either side, which a steep surface does not have [-].
"""
_SAME = 0.001
"""Elevations of a ring, and azimuths of a column, are this close [rad]."""
_NEIGHBOURS = 0.12
"""Largest angle between neighbouring rays [rad]."""


def without_mixed(scan: Scan) -> Scan:
    """Return the scan without points that lie alone between a near and a far surface.

    Neighbours are found by the directions of the points in frame S: along the rings of a turning
    LiDAR, and across them.
    """
    points = scan.points
    distance = np.sqrt(np.einsum("ij,ij->i", points, points))
    if len(points) < 5 or not (distance > 0).all():
        return scan
    rays = np.ascontiguousarray(points.T) / distance  # (3, P)
    azimuth, elevation = np.arctan2(rays[1], rays[0]), np.arcsin(np.clip(rays[2], -1, 1))
    mixed = _between(distance, rays, _groups(elevation), azimuth)
    mixed |= _between(distance, rays, _groups(azimuth), elevation)
    if not mixed.any():
        return scan
    found = {field.name: getattr(scan, field.name) for field in fields(scan)}
    alone = {k: each.compress(~mixed, axis=0) for k, each in found.items() if each is not None}
    return replace(scan, **alone)


def _groups(values: FloatArray) -> NDArray[np.int64]:
    """Return the number of the group of close values that each belongs to, (P,)."""
    order = np.argsort(values)
    steps = np.diff(values[order], prepend=values[order[0]]) > _SAME
    groups = np.empty(len(values), np.int64)
    groups[order] = np.cumsum(steps)
    return groups


def _between(
    distance: FloatArray, rays: FloatArray, group: NDArray[np.int64], place: FloatArray
) -> NDArray[np.bool_]:
    """Return which points lie between their neighbours of one group, by ``place``, (P,)."""
    order = np.lexsort((place, group))
    r, grouped = distance[order], group[order]
    x, y, z = (np.diff(axis[order]) for axis in rays)
    sine = np.sqrt(x * x + y * y + z * z)  # of the small angle to the next ray
    next_to = (grouped[1:] == grouped[:-1]) & (sine < _NEIGHBOURS) & (sine > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = 1 - sine**2 / 2
        slope = np.where(next_to, (cosine - r[:-1] / r[1:]) / sine, np.nan)
        before, after = slope[1:-2], slope[2:-1]  # of the third to the third last point
        steep = (np.minimum(np.abs(before), np.abs(after)) > _STEEP) & (before * after > 0)
        alone = (np.abs(before - slope[:-3]) > _BEND) & (np.abs(after - slope[3:]) > _BEND)
    found = np.zeros(len(distance), np.bool_)
    found[order[2:-2]] = steep & alone
    return found
