"""Where a robot can stand, as machine code; ``benchmarks.statics`` explains it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from flipperctl.api import FloatArray
from flipperctl.sim.jit import cached


@cached(njit)
def _flipper(
    heights: FloatArray, forward: int, steep: int, turns: int, sizes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest hinge at which a flipper touches, each (J, P) [m].

    Axes: place of the hinge, pitch of the chassis. ``forward`` is 1 for the front flippers and -1
    for the rear ones; ``heights`` are those of ``inflated``.
    """
    spacing, axle, step = sizes[0], sizes[2], sizes[5]
    samples = math.ceil(axle / spacing)
    angles = 2 * (steep + turns) + 1
    least = np.full((len(heights), 2 * steep + 1), np.inf)
    most = np.full((len(heights), 2 * steep + 1), -np.inf)
    needed = np.empty(angles)
    steps, rises = np.empty((angles, samples + 1), np.int64), np.empty((angles, samples + 1))
    for k in range(angles):
        angle = (k - steep - turns) * step
        for s in range(samples + 1):
            along = forward * axle * s / samples
            steps[k, s] = round(along * math.cos(angle) / spacing)
            rises[k, s] = along * math.sin(angle)
    ends = math.ceil(axle / spacing) + 1
    for j in range(ends, len(heights) - ends):
        for k in range(angles):
            height = -np.inf
            for s in range(samples + 1):
                height = max(height, heights[j + steps[k, s]] - rises[k, s])
            needed[k] = height
        for p in range(2 * steep + 1):
            for k in range(p, p + 2 * turns + 1):
                least[j, p] = min(least[j, p], needed[k])
                most[j, p] = max(most[j, p], needed[k])
    return least, most


@cached(njit)
def can_stand(
    inner: FloatArray,
    outer: FloatArray,
    places: int,
    stride: int,
    margin: int,
    steep: int,
    turns: int,
    sizes: FloatArray,
) -> NDArray[np.bool_]:
    """Return whether the robot can stand at a place with a pitch, (places, 2·steep + 1).

    ``inner`` and ``outer`` are the ``inflated`` heights for a radius that is a little smaller, for
    what must not overlap, and a little larger, for what must touch. Places of the chassis centre
    are ``margin`` and every ``stride`` past it; flippers turn by up to ``turns`` steps. ``sizes``:
    spacing, half the chassis' axis, a flipper's axis, radius, shift of the centre of mass [m], and
    the step of angles [rad].
    """
    spacing, half, radius, shift, step = sizes[0], sizes[1], sizes[3], sizes[4], sizes[5]
    front_least, _ = _flipper(inner, 1, steep, turns, sizes)
    _, front_most = _flipper(outer, 1, steep, turns, sizes)
    rear_least, _ = _flipper(inner, -1, steep, turns, sizes)
    _, rear_most = _flipper(outer, -1, steep, turns, sizes)
    samples = math.ceil(2 * half / spacing)
    found = np.zeros((places, 2 * steep + 1), np.bool_)
    for p in range(2 * steep + 1):
        cos, sin = math.cos((p - steep) * step), math.sin((p - steep) * step)
        hinge = round(half * cos / spacing)
        for i in range(places):
            centre = margin + i * stride
            front, rear = centre + hinge, centre - hinge
            lowest = max(front_least[front, p] - half * sin, rear_least[rear, p] + half * sin)
            ahead, behind = front_most[front, p] - half * sin, rear_most[rear, p] + half * sin
            for s in range(samples + 1):
                along = half * (2 * s / samples - 1)
                at = centre + round(along * cos / spacing)
                lowest = max(lowest, inner[at] - along * sin)
                touched = along * cos + radius * sin  # x of the contact, from the centre
                if touched >= -shift:
                    ahead = max(ahead, outer[at] - along * sin)
                if touched <= shift:
                    behind = max(behind, outer[at] - along * sin)
            found[i, p] = lowest <= min(ahead, behind)
    return found
