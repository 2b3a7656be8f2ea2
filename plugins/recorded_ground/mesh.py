"""Triangle meshes, seen from straight above.

In: STL, OBJ and DAE files in any frame with an axis that points up. Out: heights of the ground
along and beside a line, in the frame with x and y level and z up [m].
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray

from .clouds import upright
from .dae import read_dae
from .layers import Choice, Crossings, Ground, ground_of_faces
from .line import Line

BYTES_PER_FACE = 500
"""Bytes per allowed face above which a file is refused unread; text formats need 300."""
_EDGE = 1e-4
"""Distance by which an end of the line may lie outside the mesh [m]."""
_STEEP = 0.1
"""Largest share of a face that is seen from above at which rounding may have tilted a wall [-]."""
_MIXED = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64).view(
    np.int64
)
"""Factors with which two of a billion places have one number with a probability of 0.03 [-]."""
_INSIDE = 1e-9
"""Fraction by which a place may lie outside a triangle that it belongs to [-]."""
_AT_ONCE = 1_000_000
"""Number of pairs of a place and a triangle that are computed at once, in 100 MB."""
_TURN = 100_000
"""Number of directions around an edge that are told apart [-]."""
_NESTED = 3
"""Number of bodies inside each other that one edge may bound [-]."""


@dataclass(frozen=True)
class Mesh:
    """Triangles, whose ground at each place is one layer."""

    corners: FloatArray
    """(T, 3, 3): triangle, corner, (x, y, z) [m], counterclockwise seen from outside."""
    choice: Choice
    """Which layer is ground."""
    frame: str = ""
    """The axis that points up, in words, if the file states it."""
    remarks: tuple[str, ...] = ()
    """Remarks on what the file states."""

    @property
    def extent(self) -> FloatArray:
        """Extent in x, y and z, (3,) [m]."""
        extent: FloatArray = np.ptp(self.corners.reshape(-1, 3), axis=0)
        return extent

    def along(self, line: Line) -> Ground:
        """Return the ground at the line's points; its heights are NaN where the mesh is open.

        Raises:
            ValueError: an end of the line lies outside the mesh, or the mesh is inside out.
        """
        # Both ends of the line must be on the mesh.
        low, high = self.corners.min(axis=(0, 1)), self.corners.max(axis=(0, 1))
        for end in (line.start, line.end):
            if not ((end >= low[:2] - _EDGE) & (end <= high[:2] + _EDGE)).all():
                raise ValueError(
                    f"{end} lies outside the mesh, which covers x from {low[0]:.2f} to "
                    f"{high[0]:.2f} m and y from {low[1]:.2f} to {high[1]:.2f} m{self.frame}"
                )
        ground = self._ground(line, line.distances, np.zeros(1))

        # Backs that are seen from above: the mesh is inside out, or upside down.
        if ground.behind.any() and self._is_inside_out():
            raise ValueError(
                "the mesh is inside out: it is closed and its faces look inward; flip its normals, "
                "or cut the ceiling off if it is a room"
            )
        if ground.behind.any() and not np.isfinite(ground.height).any():
            raise ValueError(
                f"all faces along the line from {line.start} to {line.end} look down{self.frame}: "
                "the mesh is flipped or upside down; flip its normals, or set terrain.up"
            )
        return ground

    def beside(self, line: Line, along: FloatArray, left: FloatArray) -> FloatArray:
        """Return the heights on a grid, (A, L) [m]; NaN where the mesh is open.

        ``along``, (A,), are distances from the line's start in its direction and ``left``, (L,),
        distances to its left, both ascending [m]. A mesh is open where no layer is ground. There it
        has no face, or only a face seen from behind, as the bottom of a body is through a hole in
        its top.
        """
        return self._ground(line, along, left).height.reshape(len(along), len(left))

    def _is_inside_out(self) -> bool:
        """Return whether the mesh is closed, each edge having two faces, and of negative volume."""
        a, b, c = (self.corners - self.corners.mean(axis=(0, 1))).swapaxes(0, 1)
        if (a * np.cross(b, c)).sum() >= 0:  # six times its volume, if it is closed
            return False
        _, index = _joined(self.corners)
        pairs = index[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2)
        _, faces = np.unique(np.sort(pairs, axis=1), axis=0, return_counts=True)
        return bool((faces % 2 == 0).all())

    def _ground(self, line: Line, along: FloatArray, left: FloatArray) -> Ground:
        """Return the ground at the places of a grid, which are numbered row by row."""
        # Triangles near the grid, in the axes of the line
        level = self.corners[:, :, :2] - np.asarray(line.start)
        placed = np.stack([level @ line.direction, level @ line.left, self.corners[:, :, 2]], 2)
        x, y = placed[:, :, 0], placed[:, :, 1]
        ahead = (x.max(axis=1) > along[0] - _EDGE) & (x.min(axis=1) < along[-1] + _EDGE)
        near = ahead & (y.max(axis=1) > left[0] - _EDGE) & (y.min(axis=1) < left[-1] + _EDGE)
        placed = placed[near]

        # Crossings of the faces that look up, and of those that look down
        area, is_wall = _seen_from_above(placed)
        parts = [
            (places, heights, np.full(len(places), sign > 0), seen[triangles], share)
            for sign in (1.0, -1.0)
            for seen in (np.flatnonzero((area * sign > 1e-12) & ~is_wall),)
            for places, heights, triangles, share in _covered(placed[seen], along, left)
        ]
        place, height, front, face, share = map(np.concatenate, zip(*parts, strict=True))

        # Surfaces are told apart only where it matters, since that takes long.
        crossings = Crossings(place, height, front, share=share)
        bodies = crossings.in_bodies()
        is_open = bodies.surface == -1
        if (is_open & ~bodies.front).any():  # which of the faces bound a body is not clear
            crossings = replace(crossings, surface=self._surfaces[np.flatnonzero(near)[face]])
        ground = ground_of_faces(crossings, len(along) * len(left), self.choice)
        return ground.without_ceilings_over_holes(along, self.choice)

    @cached_property
    def _surfaces(self) -> NDArray[np.int64]:
        return _connected(*_joined(self.corners))


def _seen_from_above(triangles: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return twice the area in plan [m²], negative if the back is seen, and what are walls, (T,).

    Rounded coordinates tilt the triangles of vertical walls; some look down then, and would begin
    or end bodies that are none.
    """
    # A wall has hardly any area in plan, and is steep.
    sides = np.roll(triangles, -1, axis=1) - triangles
    normal = np.cross(sides[:, 0], sides[:, 1])
    area = normal[:, 2]
    narrow = np.abs(area) < _EDGE * np.hypot(sides[:, :, 0], sides[:, :, 1]).max(axis=1)
    return area, narrow & (np.abs(area) < _STEEP * np.linalg.norm(normal, axis=1))


def _joined(corners: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return places (N, 3) [m], and for each corner (T, 3) of the triangles the number of its."""
    # Corners closer than rounding are one place.
    rounded = np.round(corners.reshape(-1, 3) / _EDGE).astype(np.int64)
    mixed = rounded @ _MIXED  # a number for each place: sorting rows takes ten times as long
    _, first, index = np.unique(mixed, return_index=True, return_inverse=True)
    places = np.multiply(rounded[first], _EDGE, dtype=np.float64)
    return places, index.reshape(-1, 3).astype(np.int64)


def _covered(
    triangles: FloatArray, along: FloatArray, left: FloatArray
) -> Iterator[tuple[NDArray[np.int64], FloatArray, NDArray[np.int64], FloatArray]]:
    """Yield flat indices of the grid's places below triangles (T, 3, 3), heights, and triangles.

    Also yields shares, which add up to 1 at each place where triangles meet.
    """
    # The part of the grid around each triangle
    low, high = triangles.min(axis=1) - _INSIDE, triangles.max(axis=1) + _INSIDE
    row, column = np.searchsorted(along, low[:, 0]), np.searchsorted(left, low[:, 1])
    rows = np.searchsorted(along, high[:, 0], side="right") - row
    columns = np.searchsorted(left, high[:, 1], side="right") - column

    # Pairs of places and triangles, as many at a time as memory allows
    used = np.flatnonzero(rows * columns)
    parts = np.cumsum((rows * columns)[used]) // _AT_ONCE
    for part in np.split(used, np.flatnonzero(np.diff(parts)) + 1):
        counts = rows[part] * columns[part]
        owner = np.repeat(part, counts)  # triangle of each pair
        place = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
        i, j = row[owner] + place // columns[owner], column[owner] + place % columns[owner]
        a, b, c = (triangles[owner, corner] for corner in range(3))
        at = np.column_stack([along[i], left[j]]) - a[:, :2]
        ab, ac = b - a, c - a
        area = _cross(ab, ac)
        to_b, to_c = _cross(at, ac) / area, _cross(ab, at) / area  # weights of corners b and c
        weights = np.column_stack([1 - to_b - to_c, to_b, to_c])
        inside = (weights >= -_INSIDE).all(axis=1)
        heights = a[:, 2] + to_b * ab[:, 2] + to_c * ac[:, 2]
        shares = _shares(weights[inside], triangles[owner[inside]])
        yield (i * len(left) + j)[inside], heights[inside], owner[inside], shares


def _shares(weights: FloatArray, triangles: FloatArray) -> FloatArray:
    """Return the part of a full turn around each place that lies in its triangle, (P,) [-].

    ``weights``, (P, 3), are the weights of the corners of ``triangles``, (P, 3, 3), at the place.
    """
    # Inside a triangle a place belongs to it alone, on an edge by half, at a corner by the angle.
    zero = np.abs(weights) <= _INSIDE
    shares = np.where(zero.any(axis=1), 0.5, 1.0)
    at_corner = np.flatnonzero(zero.sum(axis=1) == 2)
    corner = weights[at_corner].argmax(axis=1)
    here, following, preceding = (
        triangles[at_corner, (corner + shift) % 3, :2] for shift in range(3)
    )
    turn = np.arctan2(
        np.abs(_cross(following - here, preceding - here)),
        ((following - here) * (preceding - here)).sum(axis=1),
    )
    shares[at_corner] = turn / (2 * np.pi)
    return shares


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the z of the cross products of (P, 2 or 3) vectors, (P,)."""
    product: FloatArray = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return product


def _connected(places: FloatArray, corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of each triangle's surface, (T,), from places (N, 3) and corners (T, 3).

    Triangles are connected over an edge if they have the same orientation there. Of several at one
    edge, as where a block stands on a tiled floor, those are that enclose the least of a body.
    """
    edge, forward, angle = _half_edges(places, corners)
    # By angle, a side that runs backwards begins a wedge of a body and the next forward one ends
    # it. Where a body stands on a sheet, it ends before the sheet's begins.
    order = np.lexsort((~forward, angle, edge))
    order = order[edge[order] >= 0]
    pairs: list[NDArray[np.int64]] = []
    for _ in range(_NESTED):
        first = np.flatnonzero(np.append(True, np.diff(edge[order]) != 0)[: len(order)])
        following = np.arange(1, len(order) + 1)
        following[np.append(first[1:], len(order)) - 1] = first  # around the edge
        begins = np.flatnonzero(~forward[order] & forward[order[following]])
        ends = following[begins]
        pairs.append(order[np.stack([begins, ends])])
        order = np.delete(order, np.concatenate([begins, ends]))
        if not len(order):
            break

    # Triangles that share a wedge are connected.
    face, neighbour = np.concatenate(pairs, axis=1) // 3  # the triangles of the sides
    size = (len(corners), len(corners))
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(face), np.bool_), (face, neighbour)), size)
    labels: NDArray[np.int64] = connected_components(graph, directed=False)[1].astype(np.int64)
    return labels


def _half_edges(
    places: FloatArray, corners: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64]]:
    """Return the edge, the direction along it and the angle around it of each side, (3 T,).

    The edge is -1 for a side without a length. Angles are whole numbers from 0 to ``_TURN``, about
    the edge's direction from its lower to its higher place, and 0 at edges of two triangles.
    """
    # The sides of the triangles, and the edges that they share
    tail, head, opposite = (np.roll(corners, -shift, axis=1).ravel() for shift in range(3))
    low, high = np.minimum(tail, head), np.maximum(tail, head)
    _, edge = np.unique(low * len(places) + high, return_inverse=True)

    # At edges of more than two triangles, the angle of each around the edge
    shared = np.flatnonzero(np.bincount(edge)[edge] > 2)
    start = places[low[shared]]
    along, side = places[high[shared]] - start, places[opposite[shared]] - start
    across = np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)])
    upwards = np.cross(along, across)
    upwards /= np.maximum(np.linalg.norm(along, axis=1), 1e-12)[:, None]
    turned = np.arctan2((side * upwards).sum(axis=1), (side * across).sum(axis=1)) / (2 * np.pi)
    angle = np.zeros(len(edge), np.int64)
    angle[shared] = np.round(turned * _TURN).astype(np.int64) % _TURN
    return np.where(low == high, -1, edge), tail < head, angle


def read_mesh(path: Path, unit: float | None, up: str | None, most: int, choice: Choice) -> Mesh:
    """Return a file's triangles; ``unit`` [m] and ``up`` prevail over those that a DAE states.

    Other files are in metres with z up unless these are given.

    Raises:
        ValueError: it has no faces, more than ``most``, or a coordinate that is not finite.
    """
    if (size := path.stat().st_size) > most * BYTES_PER_FACE:
        raise ValueError(
            f"the mesh is too large: {size / 1e6:.0f} MB for largest_mesh of {most} faces"
        )
    # Units and axes only a DAE states
    suffix, stated = path.suffix.lower(), (1.0, "Z_UP")
    if suffix == ".dae":
        file = read_dae(path)
        triangles, stated = file.corners, (file.unit, file.up)
    else:
        import trimesh

        with path.open("rb") as stream:
            kind = {"file_type": suffix[1:], "process": False, "skip_materials": True}
            mesh: Any = trimesh.load_mesh(stream, **kind)
        triangles = mesh.triangles if hasattr(mesh, "triangles") else np.empty((0, 3, 3))

    # In metres with z up, with as many faces as are allowed
    frame = f" with {stated[1]}, which it states; terrain.up prevails" if up is None else ""
    unit, up = _checked_frame(unit, up, *stated)
    if (count := len(triangles)) == 0:
        raise ValueError("it has no faces")
    if count > most:
        raise ValueError(f"the mesh is too large: it has {count} faces; largest_mesh allows {most}")
    points = np.asarray(triangles, dtype=np.float64).reshape(-1, 3) * unit
    if not np.isfinite(points).all():
        raise ValueError("a coordinate of the mesh is not a finite number")
    corners = upright(points, up).reshape(-1, 3, 3)
    if suffix != ".dae":
        return Mesh(corners, choice)
    return Mesh(corners, choice, frame, tuple(_remark_on_side(corners, stated[1], frame)))


def _remark_on_side(corners: FloatArray, stated: str, frame: str) -> Iterator[str]:
    """Yield a remark if a mesh may lie on its side since the file states the wrong axis."""
    x, y, z = np.ptp(corners.reshape(-1, 3), axis=0)
    if frame and stated != "Z_UP" and z > min(x, y):
        yield (
            f"it is {z:.2f} m high and {x:.2f} by {y:.2f} m in plan{frame}; many programs write "
            "Y_UP without turning the mesh: does it lie on its side?"
        )


def _checked_frame(
    unit: float | None, up: str | None, stated_unit: float, stated_up: str
) -> tuple[float, str]:
    """Return the unit [m] and the axis that points up: those given, or else those stated.

    Raises:
        ValueError: a stated one is needed and no unit or no axis.
    """
    if unit is None and not 0 < stated_unit < np.inf:
        raise ValueError(f"it states a unit of {stated_unit:g} m; terrain.unit prevails")
    if up is None and stated_up not in ("X_UP", "Y_UP", "Z_UP"):
        raise ValueError(f"it states {stated_up} as the axis that points up; terrain.up prevails")
    return stated_unit if unit is None else unit, stated_up[0].lower() if up is None else up
