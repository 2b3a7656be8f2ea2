"""Measures of a sensor that maps the ground: errors of the map, drift, and what was never seen.

Try it: ``flipperctl eval --controller okada sim=mujoco perception=lidar --plugins
examples/mapping.py terrain=step``
"""

from collections.abc import Iterator, Sequence

import numpy as np

from flipperctl.api import Measure, Perception, Transition, measure
from flipperctl.core.bins import mean_heights

SPACING = 0.02  # of the points of the true ground [m]


@measure("map_error")
class MapError(Measure):
    """Mean absolute error of the heights H of the observation, over bins and decisions [m]."""

    unit = "m"
    digits = 4

    def __call__(self, episode: Sequence[Transition]) -> float:
        layout = _perceived(episode[0]).layout
        cloud = episode[0].profile.sample(SPACING, layout.reach + 30.0)
        errors = []
        for t in episode:
            p = _perceived(t)
            near = cloud - t.before.position
            near = near[(near[:, 0] >= -layout.reach) & (near[:, 0] < layout.reach)]
            true = mean_heights(near, layout.bins, layout.bin_width)
            errors.append(np.abs(p.observation[: layout.bins] - true).mean())
        return float(np.mean(errors))


@measure("drift")
class Drift(Measure):
    """Distance between the motion by odometry and the true one at the end of the episode [m].

    It is 0 for a sensor without odometry.
    """

    unit = "m"
    digits = 3

    def __call__(self, episode: Sequence[Transition]) -> float:
        first, last = (_perceived(episode[i]).position for i in (0, -1))
        if first is None or last is None:
            return 0.0
        true = episode[-1].before.position - episode[0].before.position
        return float(np.linalg.norm(last - first - true))


@measure("unseen")
class Unseen(Measure):
    """Mean fraction of the bins that were never seen [-]."""

    unit = "-"
    digits = 3

    def __call__(self, episode: Sequence[Transition]) -> float:
        return float(np.mean([0.0 if seen is None else 1 - seen.mean() for seen in _seen(episode)]))


def _seen(episode: Sequence[Transition]) -> Iterator[np.ndarray | None]:
    return (_perceived(t).seen for t in episode)


def _perceived(t: Transition) -> Perception:
    assert t.perception is not None  # it is None in predictions, of which there are no measures
    return t.perception
