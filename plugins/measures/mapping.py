"""Measures of a sensor that maps the ground: errors of the map, drift, and what was never seen."""

from collections.abc import Sequence

import numpy as np

from flipperctl.api import FloatArray, Perception, Transition, measure
from flipperctl.core.observation import bin_heights

_SPACING = 0.02
"""Distance between points of the true ground [m]."""
_MARGIN = 30.0
"""Length of level ground before and past the profile [m]."""


def height_errors(episode: Sequence[Transition]) -> FloatArray:
    """Return the errors of the mean heights H at each decision, perceived - true, (T, N) [m]."""
    layout = _perceived(episode[0]).layout
    cloud = episode[0].profile.sample(_SPACING, layout.reach + _MARGIN)
    errors = np.empty((len(episode), layout.bins))
    for row, t in zip(errors, episode, strict=True):
        x = t.before.position[0]
        # The true ground around the robot, as a sensor without errors has it
        first, last = np.searchsorted(cloud[:, 0], (x - layout.reach, x + layout.reach))
        near = cloud[first:last] - t.before.position
        true = bin_heights(near, layout.bins, layout.bin_width, highest=False)
        row[:] = _perceived(t).observation[: layout.bins] - true
    return errors


@measure("map_error", unit="m", digits=4, mapped_only=True)
def map_error(episode: Sequence[Transition]) -> float:
    """Mean absolute error of the heights H of the observation [m].

    Ground that was filled counts as well.
    """
    return float(np.abs(height_errors(episode)).mean())


@measure("map_error_below", unit="m", digits=4, mapped_only=True)
def map_error_below(episode: Sequence[Transition]) -> float:
    """Mean absolute error of the heights H in the bins below the chassis [m]."""
    layout = _perceived(episode[0]).layout
    centres = (np.arange(layout.bins) - (layout.bins - 1) / 2) * layout.bin_width
    below = np.abs(centres) <= episode[0].robot.chassis_length / 2
    if not below.any():  # one wide bin beside the centre
        below = np.abs(centres) == np.abs(centres).min()
    return float(np.abs(height_errors(episode)[:, below]).mean())


@measure("drift", unit="m", digits=3, mapped_only=True)
def drift(episode: Sequence[Transition]) -> float:
    """Error of the distance by odometry at the last decision [m].

    It is taken in the side plane, and 0 for a sensor without odometry.
    """
    first, last = (_perceived(episode[i]).position for i in (0, -1))
    if first is None or last is None:
        return 0.0
    true = episode[-1].before.position - episode[0].before.position
    return float(np.linalg.norm(last - first - true))


@measure("unseen", digits=3, mapped_only=True)
def unseen(episode: Sequence[Transition]) -> float:
    """Mean fraction of the bins that were never seen, over decisions [-]."""
    seen = [_perceived(t).seen for t in episode]
    return float(np.mean([0.0 if bins is None else 1 - bins.mean() for bins in seen]))


def _perceived(t: Transition) -> Perception:
    assert t.perception is not None  # it is None in predictions alone, which are not measured
    return t.perception
