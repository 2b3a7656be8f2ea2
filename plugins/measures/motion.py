"""Measures of an episode's motion: duration, flippers, standstill, impacts, pitch and roll.

At decisions, the roll is 0 in an engine of the side plane.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np

from flipperctl.api import FloatArray, Transition, measure
from flipperctl.core.targets import turned

from ..posture import with_masses
from .latest import stored

_OVERTURNED = math.pi / 3
"""Absolute pitch of an overturned robot: the paper's limit [rad]."""
_SLOW = 0.1
"""Fraction of the belts' speed below which the chassis stands still [-]."""


@measure("decisions")
def decisions(episode: Sequence[Transition]) -> int:
    """Number of decisions in the episode [-]."""
    return len(episode)


@measure("t_cost", unit="s", digits=1, reached_only=True, better="lower")
def t_cost(episode: Sequence[Transition]) -> float:
    """Simulated time from the start to the end of the episode [s]."""
    return episode[-1].after.time


@measure("flipper_travel", unit="rad", reached_only=True, better="lower")
def flipper_travel(episode: Sequence[Transition]) -> float:
    """Sum of the absolute turns of both flipper pairs between decisions [rad].

    Of four flippers, the mean of both sides counts.
    """
    return _total(sum(turned(t)) for t in episode)


@measure("flipper_energy", unit="J", digits=1, reached_only=True, better="lower", in_tables=False)
def flipper_energy(episode: Sequence[Transition]) -> float:
    """Integral of the absolute power (torque × speed) of all flippers [J].

    Braking counts as driving does, since a flipper's gear gives no energy back; a torque that holds
    a flipper still does no work. It is 0 in an engine that does not measure it.
    """
    return _total(t.flipper_work or 0.0 for t in episode)


@measure("standstill", unit="s", digits=1, better="lower", in_tables=False)
def standstill(episode: Sequence[Transition]) -> float:
    """Time below a tenth of the belts' speed [s].

    It is the time of the samples, 10 ms each, with a smaller mean speed.
    """
    period = episode[0].sample_period
    limit = _SLOW * with_masses(episode[0].robot).track_speed * period  # [m]
    return period * int(np.count_nonzero(np.hypot(*_motion(episode).steps) < limit))


@measure("largest_impact", unit="m/s", better="lower", in_tables=False)
def largest_impact(episode: Sequence[Transition]) -> float:
    """Largest change of the chassis centre's velocity within 10 ms [m/s].

    The velocities are means over samples 10 ms apart. The mass of the robot times this over 10 ms
    is the mean force of the impact.
    """
    x, z = _motion(episode).steps / episode[0].sample_period
    return float(np.hypot(x[1:] - x[:-1], z[1:] - z[:-1]).max(initial=0.0))


@measure("pitch_variation_decisions", unit="rad", reached_only=True, better="lower")
def pitch_variation(episode: Sequence[Transition]) -> float:
    """Sum of the pitch changes between decisions: θ̂_R of paper Eq. 8 [rad]."""
    return _total(abs(t.after.pitch - t.before.pitch) for t in episode)


@measure("pitch_variation_100hz", unit="rad", reached_only=True, better="lower")
def pitch_variation_100hz(episode: Sequence[Transition]) -> float:
    """θ̂_R between poses 10 ms apart, motion within decisions included [rad]."""
    motion = _motion(episode)
    changes = np.abs(motion.pitches[1:] - motion.pitches[:-1])
    return _total(float(np.add.reduce(changes[i : j - 1])) for i, j in pairwise(motion.bounds))


@measure("max_pitch", unit="rad", better="lower")
def max_pitch(episode: Sequence[Transition]) -> float:
    """Largest absolute pitch, over poses 10 ms apart [rad]."""
    return float(np.abs(_motion(episode).pitches).max())


@measure("pitch_reserve", unit="rad", better="higher", in_tables=False)
def pitch_reserve(episode: Sequence[Transition]) -> float:
    """Smallest distance of the pitch from overturning at π/3 [rad].

    It is 0 or less if the robot overturned.
    """
    return _OVERTURNED - float(np.abs(_motion(episode).pitches).max())


@measure("max_roll", unit="rad", better="lower", in_tables=False)
def max_roll(episode: Sequence[Transition]) -> float:
    """Largest absolute roll at decisions, the start included [rad]."""
    return max(abs(episode[0].before.roll), *(abs(t.after.roll) for t in episode))


@measure("roll_variation_decisions", unit="rad", reached_only=True, better="lower", in_tables=False)
def roll_variation(episode: Sequence[Transition]) -> float:
    """Sum of the roll changes between decisions [rad]."""
    return _total(abs(t.after.roll - t.before.roll) for t in episode)


@measure("roll_variation_100hz", unit="rad", reached_only=True, better="lower", rolled_only=True)
def roll_variation_100hz(episode: Sequence[Transition]) -> float:
    """Sum of the roll changes between poses 10 ms apart, in 3-D alone [rad]."""
    return _total(t.roll_variation or 0.0 for t in episode)


def _total(values: Iterable[float]) -> float:
    """Return the sum in order, since ``sum`` rounds floats differently from Python 3.12 on."""
    total = 0.0
    for value in values:
        total += value
    return total


class _Motion(NamedTuple):
    """The paths of an episode's decisions, joined."""

    pitches: FloatArray  # of all poses in order, (P,) [rad]
    bounds: list[int]  # where each decision's poses begin among them, and where the last ones end
    steps: FloatArray  # motion of the chassis centre from sample to sample, (2, S) [m]


@stored
def _motion(episode: Sequence[Transition]) -> _Motion:
    x, z, pitches = np.concatenate([t.path for t in episode]).T.copy()
    bounds = [0, *accumulate(len(t.path) for t in episode)]
    # A decision's first pose is the last pose of the one before, which counts once.
    once = np.ones(len(pitches), np.bool_)
    once[bounds[1:-1]] = False
    centre = np.stack([x[once], z[once]])
    return _Motion(pitches, bounds, centre[:, 1:] - centre[:, :-1])
