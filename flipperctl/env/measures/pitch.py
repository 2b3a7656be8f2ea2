"""Measures of the chassis' pitch."""

from typing import ClassVar

import numpy as np

from flipperctl.api import Transition


class PitchVariation:
    """θ̂_R, the sum of the absolute pitch changes from decision to decision (paper Eq. 8) [rad]."""

    name: ClassVar[str] = "pitch_variation"
    heading: ClassVar[str] = "θ̂_R at decisions [rad]"
    digits: ClassVar[int] = 2
    reached_only: ClassVar[bool] = True

    def __init__(self) -> None:
        self.value = 0.0

    def add(self, t: Transition) -> None:
        """Add the absolute change of the pitch over one decision."""
        self.value += abs(t.after.pitch - t.before.pitch)


class PitchVariation100Hz:
    """θ̂_R from pose to pose, 10 ms apart, which includes motion within decisions [rad]."""

    name: ClassVar[str] = "pitch_variation_100hz"
    heading: ClassVar[str] = "θ̂_R [rad]"
    digits: ClassVar[int] = 2
    reached_only: ClassVar[bool] = True

    def __init__(self) -> None:
        self.value = 0.0

    def add(self, t: Transition) -> None:
        """Add the absolute changes of the pitch within one decision."""
        pitch = t.path[:, 2]
        self.value += float(np.add.reduce(np.abs(pitch[1:] - pitch[:-1])))


class MaxPitch:
    """Largest absolute pitch of the poses, 10 ms apart [rad]."""

    name: ClassVar[str] = "max_pitch"
    heading: ClassVar[str] = "largest pitch [rad]"
    digits: ClassVar[int] = 2
    reached_only: ClassVar[bool] = False

    def __init__(self) -> None:
        self.value = 0.0

    def add(self, t: Transition) -> None:
        """Update the maximum with the poses of one decision, including the pose before it."""
        self.value = max(self.value, float(np.maximum.reduce(np.abs(t.path[:, 2]))))
