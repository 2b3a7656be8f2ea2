"""Measures of the chassis' pitch and roll; the roll is 0 in an engine of the side plane."""

import math
from collections.abc import Sequence

import numpy as np

from flipperctl.api import FloatArray, Transition, measure

_OVERTURNED = math.pi / 3
"""Absolute pitch of an overturned robot: the paper's limit [rad]."""


@measure("pitch_variation", unit="rad", reached_only=True, better="lower")
def pitch_variation(episode: Sequence[Transition]) -> float:
    """θ̂_R, the sum of the absolute pitch changes from decision to decision (paper Eq. 8) [rad]."""
    total = 0.0
    for t in episode:
        total += abs(t.after.pitch - t.before.pitch)
    return total


@measure("pitch_variation_100hz", unit="rad", reached_only=True, better="lower")
def pitch_variation_100hz(episode: Sequence[Transition]) -> float:
    """θ̂_R between poses 10 ms apart, which includes motion within decisions [rad]."""
    total = 0.0
    for t in episode:
        pitch = t.path[:, 2]
        total += float(np.add.reduce(np.abs(pitch[1:] - pitch[:-1])))
    return total


@measure("max_pitch", unit="rad", better="lower")
def max_pitch(episode: Sequence[Transition]) -> float:
    """Largest absolute pitch over poses 10 ms apart, including that at the start [rad]."""
    return float(np.maximum.reduce(np.abs(_pitches(episode))))


@measure("pitch_reserve", unit="rad", better="higher", in_tables=False)
def pitch_reserve(episode: Sequence[Transition]) -> float:
    """Smallest distance of the pitch from overturning at π/3, over poses 10 ms apart [rad].

    It is 0 or less if the robot overturned.
    """
    return _OVERTURNED - float(np.abs(_pitches(episode)).max())


@measure("max_roll", unit="rad", better="lower", in_tables=False)
def max_roll(episode: Sequence[Transition]) -> float:
    """Largest absolute roll at decisions, the start included [rad]."""
    return max(abs(episode[0].before.roll), *(abs(t.after.roll) for t in episode))


@measure("roll_variation", unit="rad", reached_only=True, better="lower", in_tables=False)
def roll_variation(episode: Sequence[Transition]) -> float:
    """Sum of the absolute roll changes from decision to decision, as θ̂_R for the pitch [rad]."""
    total = 0.0
    for t in episode:
        total += abs(t.after.roll - t.before.roll)
    return total


def _pitches(episode: Sequence[Transition]) -> FloatArray:
    return np.concatenate([t.path[:, 2] for t in episode])
