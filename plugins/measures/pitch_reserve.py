"""The distance to overturning."""

import math
from collections.abc import Sequence

import numpy as np

from flipperctl.api import Measure, Transition, measure

_OVERTURNED = math.pi / 3
"""Absolute pitch of an overturned robot: the paper's limit [rad]."""


@measure("pitch_reserve")
class PitchReserve(Measure):
    """Smallest distance of the pitch from overturning at π/3, over poses 10 ms apart [rad]."""

    unit = "rad"
    better = "higher"
    in_tables = False

    def __call__(self, episode: Sequence[Transition]) -> float:
        """Return π/3 minus the largest absolute pitch; 0 or less if overturned [rad]."""
        pitches = np.concatenate([t.path[:, 2] for t in episode])
        return _OVERTURNED - float(np.abs(pitches).max())
