"""Measures of an episode's motion: duration, flippers, standstill and impacts.

Here and in ``rotation`` the sums are loops, since ``sum`` rounds floats differently from Python
3.12 on.
"""

from collections.abc import Sequence

import numpy as np

from flipperctl.api import FloatArray, Transition, measure

from ..posture import with_masses

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
    """Sum of the absolute turns of both flipper pairs from decision to decision [rad]."""
    total = 0.0
    for t in episode:
        total += abs(t.after.front - t.before.front) + abs(t.after.rear - t.before.rear)
    return total


@measure("flipper_energy", unit="J", digits=1, reached_only=True, better="lower", in_tables=False)
def flipper_energy(episode: Sequence[Transition]) -> float:
    """Integral of the absolute power (torque × angular speed) of all flippers [J].

    Braking counts as driving does, since a flipper's gear gives no energy back; a torque that holds
    a flipper still does no work. It is 0 in an engine that does not measure it.
    """
    total = 0.0
    for t in episode:
        total += t.flipper_work or 0.0
    return total


@measure("standstill", unit="s", digits=1, better="lower", in_tables=False)
def standstill(episode: Sequence[Transition]) -> float:
    """Time in which the chassis centre moved slower than a tenth of the belts' speed [s].

    It is the time of the samples, 10 ms each, with a smaller mean speed.
    """
    period = episode[0].sample_period
    limit = _SLOW * with_masses(episode[0].robot).track_speed * period  # [m]
    steps = _steps(episode)
    return period * int(np.count_nonzero(np.hypot(steps[:, 0], steps[:, 1]) < limit))


@measure("largest_impact", unit="m/s", better="lower", in_tables=False)
def largest_impact(episode: Sequence[Transition]) -> float:
    """Largest change of the chassis centre's velocity within 10 ms [m/s].

    The velocities are means over samples 10 ms apart. The mass of the robot times this over 10 ms
    is the mean force of the impact.
    """
    change = np.diff(_steps(episode) / episode[0].sample_period, axis=0)
    return float(np.hypot(change[:, 0], change[:, 1]).max(initial=0.0))


def _steps(episode: Sequence[Transition]) -> FloatArray:
    """Return the motion of the chassis centre from sample to sample, (S, 2) [m]."""
    poses = [episode[0].path[:1], *(t.path[1:] for t in episode)]
    return np.diff(np.concatenate(poses)[:, :2], axis=0)
