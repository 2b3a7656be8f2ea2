"""Angles of the flippers from ``JointState`` messages, which may hold a part of the joints each.

In: names and positions of joints, with stamps. Out: the mean angle of each pair of flippers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from flipperctl.runtime.messages import JointAngles


class NewestJoints:
    """The newest angle of each flipper's joint."""

    def __init__(self, front: Sequence[str], rear: Sequence[str]) -> None:
        """``front`` and ``rear``: names of the joints of each pair."""
        self._pairs = front, rear
        self._angles: dict[str, tuple[float, float]] = {}  # joint → its stamp and angle

    def take(
        self, stamp: float, names: Iterable[str], positions: Iterable[float]
    ) -> JointAngles | None:
        """Receive a message; return the angles of the pairs, of the stamp of the oldest of them.

        None: the message is of other joints, or there is a joint without an angle yet.
        """
        ours = {name for pair in self._pairs for name in pair}
        told = {n: (stamp, float(p)) for n, p in zip(names, positions, strict=False) if n in ours}
        self._angles |= told
        if not told or ours - self._angles.keys():
            return None
        oldest = float(np.min([time for time, _ in self._angles.values()]))  # NaN if one is
        front, rear = (math.fsum(self._angles[n][1] for n in p) / len(p) for p in self._pairs)
        return JointAngles(oldest, front, rear)
