"""A learned value of what is perceived, with all that a search needs to use it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, ObservationLayout, RewardTerm

Value = Callable[[NDArray[np.float32]], FloatArray]
"""Returns the expected discounted return from observations (M, N + 3), (M,) [-]."""


@dataclass(frozen=True)
class LearnedValue:
    """The value of a trained policy."""

    value: Value
    rewards: Mapping[str, RewardTerm]
    """Reward terms that it was trained with."""
    gamma: float
    """Discount per decision [-]."""
    layout: ObservationLayout
    """Layout of its observations."""
