"""A learned value of what is perceived, with all that a search needs to use it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, ObservationLayout, RewardTerm, RobotGeometry

Value = Callable[[NDArray[np.float32]], FloatArray]
"""Returns the expected discounted return from observations (M, N + 3), (M,) [-]."""
TOLERANCE = 0.02
"""Largest relative difference of a dimension that was not randomised in the training [-]."""


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
    sizes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Smallest and largest dimension of the robots of its training, by field of ``RobotGeometry``
    [m, rad]; those that are missing may have any size."""

    def misfits(self, robot: RobotGeometry, layout: ObservationLayout) -> Iterator[str]:
        """Yield what of a robot and its observations the values were not trained for."""
        for name, (low, high) in self.sizes.items():
            if not low <= (size := getattr(robot, name)) <= high:
                yield f"robot.{name}={size:.4g} ({low:.4g} to {high:.4g})"
        if layout.reach < (1 - TOLERANCE) * self.layout.reach:
            yield f"ground perceived up to {layout.reach:.4g} m ({self.layout.reach:.4g} m)"
