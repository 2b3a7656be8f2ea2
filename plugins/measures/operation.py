"""Measures of episodes that an operator drove: how much of it, and how long the belts stood."""

from collections.abc import Sequence

import numpy as np

from flipperctl.api import Transition, measure

_STANDS = 0.05
"""Share of the belts' speed below which they stand [-]."""


@measure("taken", operated_only=True)
def taken(episode: Sequence[Transition]) -> float:
    """Share of the time for which the operator commands a pair of flippers [-].

    It is the mean of both pairs: 1 without shared control, where no policy commands the rest.
    """
    return float(
        np.concatenate([t.commands[:, 3:5] for t in episode if t.commands is not None]).mean()
    )


@measure("belts_stood", unit="s", digits=1, operated_only=True)
def belts_stood(episode: Sequence[Transition]) -> float:
    """Time for which the operator let the belts stand [s]."""
    total = 0.0
    for t in episode:
        if t.commands is not None:
            lasted = t.sample_period * (len(t.path) - 1)
            total += lasted * float((np.abs(t.commands[:, 2]) < _STANDS).mean())
    return total
