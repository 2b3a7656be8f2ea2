"""Connected surfaces of a triangle mesh.

In: the triangles' corners. Out: the number of the surface that each triangle belongs to.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

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
    owner = np.repeat(np.arange(len(corners)), 3)
    # By angle, a face that looks back begins a wedge of a body, and the next one ends it. Where a
    # body stands on a sheet, the body ends first.
    left = np.lexsort((~forward, angle, edge))
    left = left[edge[left] >= 0]
    pairs: list[NDArray[np.int64]] = []
    for _ in range(_NESTED):
        begins = np.append(True, edge[left][1:] != edge[left][:-1])[: len(left)]
        following = np.arange(1, len(left) + 1)
        lasts = np.append(begins[1:], True)[: len(left)]
        following[lasts] = np.flatnonzero(begins)
        first = np.flatnonzero(~forward[left] & forward[left][following])
        pairs.append(np.stack([left[first], left[following[first]]]))
        left = np.delete(left, np.concatenate([first, following[first]]))
    first, second = owner[np.concatenate(pairs, axis=1)]
    size = (len(corners), len(corners))
    graph = coo_array((np.ones(len(first), np.bool_), (first, second)), size)
    labels: NDArray[np.int64] = connected_components(graph, directed=False)[1].astype(np.int64)
    return labels


def _half_edges(
    places: FloatArray, corners: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64]]:
    """Return the edge, the direction along it and the angle around it of each side, (3 T,).

    The edge is -1 for a side without a length. Angles are whole numbers from 0 to ``_TURN``, about
    the edge's direction from its lower to its higher place.
    """
    tail, head, opposite = (np.roll(corners, -shift, axis=1).ravel() for shift in range(3))
    forward = tail < head
    low, high = np.minimum(tail, head), np.maximum(tail, head)
    _, edge = np.unique(low * len(places) + high, return_inverse=True)
    along = places[high] - places[low]
    third = np.eye(3)[np.abs(along).argmin(axis=1)]
    across = np.cross(along, third)
    upwards = np.cross(along, across) / np.maximum(np.linalg.norm(along, axis=1), 1e-12)[:, None]
    side = places[opposite] - places[low]
    angle = np.arctan2((side * upwards).sum(axis=1), (side * across).sum(axis=1))
    ticks = np.round(angle * _TURN / (2 * np.pi)).astype(np.int64) % _TURN
    return np.where(low == high, -1, edge), forward, ticks
