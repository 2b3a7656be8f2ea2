"""Connected surfaces of a triangle mesh.

In: the triangles' corners. Out: the number of the surface that each triangle belongs to.
"""

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray

_TURN = 100_000
"""Number of directions around an edge that are told apart [-]."""
_NESTED = 3
"""Number of bodies inside each other that one edge may bound [-]."""


def surfaces(places: FloatArray, corners: NDArray[np.int64]) -> NDArray[np.int64]:
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
    one, other = np.concatenate(pairs, axis=1) // 3  # the triangles of the sides
    size = (len(corners), len(corners))
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(one), np.bool_), (one, other)), size)
    labels: NDArray[np.int64] = connected_components(graph, directed=False)[1].astype(np.int64)
    return labels


def _half_edges(
    places: FloatArray, corners: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64]]:
    """Return the edge, the direction along it and the angle around it of each side, (3 T,).

    The edge is -1 for a side without a length. Angles are whole numbers from 0 to ``_TURN``, about
    the edge's direction from its lower to its higher place, and 0 at edges of two triangles.
    """
    tail, head, opposite = (np.roll(corners, -shift, axis=1).ravel() for shift in range(3))
    low, high = np.minimum(tail, head), np.maximum(tail, head)
    _, edge = np.unique(low * len(places) + high, return_inverse=True)
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
