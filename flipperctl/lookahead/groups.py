"""Groups of states of one ground with the values of their actions, from which a student learns.

In: a graph. Out: groups of states that lie close to each other. A student that sees a metre of the
ground cannot know what comes after; states of one group share it, so that their differences are
what the student can learn.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import ACTIONS, FloatArray, ObservationLayout, StateGroups, action_index
from flipperctl.lookahead.graph import Graph
from flipperctl.lookahead.heights import Ground

SIZE = 16
"""Number of states of a group [-]."""
_WINDOW = 0.15
"""Largest distance of a group's states from its middle, at 0.12 m a decision [m]."""
_WALKERS, _STEPS = 96, 120
"""Number of walks along the ground, and their largest length in decisions [-]."""
_RANDOM = (0.0, 0.05, 0.1, 0.2)
"""Probabilities that a walk begins some equal random decisions [-]."""
_EQUAL = 6
"""Number of equal random decisions in a row that a walk stays below [-]."""


def sample_groups(
    graph: Graph,
    line: FloatArray,
    layout: ObservationLayout,
    rng: np.random.Generator,
    *,
    count: int,
    off_path: float,
    unseen: float,
    way: float,
) -> StateGroups:
    """Return ``count`` groups, a fraction ``off_path`` of them around any represented states.

    The others lie around states of walks that follow the best actions, with random ones between.
    In a fraction ``unseen`` of the groups the ground is level from a random bin ahead on.
    ``line``: the ground, (V, 2) [m]; ``way``: distance of a decision at full speed [m].
    """
    values = with_stops(graph.values)
    x = graph.nodes.places[:, 0]
    order = np.argsort(x, kind="stable")
    walked = _walks(graph, rng)
    anywhere = rng.integers(len(x), size=count)
    near = walked[rng.integers(len(walked), size=count)]
    centre = x[np.where(rng.random(count) < off_path, anywhere, near)]
    window = _WINDOW * way / 0.12
    pools = (order, walked[np.argsort(x[walked], kind="stable")])
    members = np.empty((count, SIZE), np.int64)
    for half, pool in enumerate(pools):  # half of each group from each pool
        at = x[pool]
        low = np.searchsorted(at, centre - window)
        high = np.maximum(low + 1, np.searchsorted(at, centre + window))
        picked = low[:, None] + (rng.random((count, SIZE // 2)) * (high - low)[:, None]).astype(int)
        picked = np.minimum(picked, len(pool) - 1)
        members[:, half * SIZE // 2 : (half + 1) * SIZE // 2] = pool[picked]
    rows = members.ravel()
    nodes = graph.nodes.take(rows)
    seen = Ground(line, layout).observations(nodes.places, nodes.states)
    hidden = rng.random(count) < unseen
    first = np.where(hidden, rng.integers(layout.bins // 2 + 1, layout.bins, count), layout.bins)
    return StateGroups(
        observations=_levelled(seen, np.repeat(first, SIZE), layout).reshape(count, SIZE, -1),
        values=values[rows].astype(np.float32).reshape(count, SIZE, -1),
    )


def _levelled(
    seen: NDArray[np.float32], first: NDArray[np.int64], layout: ObservationLayout
) -> NDArray[np.float32]:
    """Return observations (M, N + 3) whose heights from the bin ``first`` (M,) on are level."""
    bins = np.arange(layout.bins)
    last = seen[np.arange(len(seen)), first - 1]
    found = seen.copy()
    found[:, : layout.bins] = np.where(
        bins >= first[:, None], last[:, None], seen[:, : layout.bins]
    )
    return found


def with_stops(values: FloatArray) -> FloatArray:
    """Return values (M, 9) in which a turn beyond a stop has the value of not making it.

    Such a turn changes nothing. If both pairs are at a stop, neither turns.
    """
    filled = values.copy()
    for front, rear in ACTIONS:
        action = action_index(front, rear)
        for other in ((0, rear), (front, 0), (0, 0)):
            missing = ~np.isfinite(filled[:, action])
            filled[missing, action] = values[missing, action_index(*other)]
    return filled


def _walks(graph: Graph, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return the states of walks from the start, in which random actions persist."""
    best, x = graph.values.argmax(axis=1), graph.nodes.places[:, 0]
    starts = np.flatnonzero(x < x.min() + 1.0)
    at = rng.choice(starts, _WALKERS)
    share = rng.choice(_RANDOM, _WALKERS)
    left, action = np.zeros(_WALKERS, np.int64), np.zeros(_WALKERS, np.int64)
    seen = []
    for _ in range(_STEPS):
        seen.append(at)
        begins = (left == 0) & (rng.random(len(at)) < share)
        left = np.where(begins, rng.integers(1, _EQUAL, len(at)), left)
        action = np.where(begins, rng.integers(len(ACTIONS), size=len(at)), action)
        chosen = np.where((left > 0) & np.isfinite(graph.values[at, action]), action, best[at])
        child = graph.child[at, chosen]
        going = child >= 0
        at, share, action = child[going], share[going], action[going]
        left = np.maximum(0, left[going] - 1)
        if not len(at):
            break
    return np.concatenate(seen)
