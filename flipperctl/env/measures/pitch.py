"""How much the chassis pitched."""

from typing import ClassVar

import numpy as np

from flipperctl.api import Transition


class PitchVariation:
    """θ̂_R, the sum of the absolute pitch changes from decision to decision (paper Eq. 8) [rad]."""

    name: ClassVar[str] = "pitch_variation"
    heading: ClassVar[str] = "θ̂_R [rad]"
    digits: ClassVar[int] = 2
    reached_only: ClassVar[bool] = True

    def __init__(self) -> None:
        self.value = 0.0

    def add(self, t: Transition) -> None:
        """Add the change within one decision."""
        self.value += abs(t.after.pitch - t.before.pitch)


class PitchVariation100Hz:
    """The same from pose to pose, 10 ms apart: the swing that the robot feels [rad]."""

    name: ClassVar[str] = "pitch_variation_100hz"
    heading: ClassVar[str] = "θ̂_R 100 Hz [rad]"
    digits: ClassVar[int] = 2
    reached_only: ClassVar[bool] = True

    def __init__(self) -> None:
        self.value = 0.0

    def add(self, t: Transition) -> None:
        """Add the changes within one decision."""
        self.value += float(np.abs(np.diff(t.path[:, 2])).sum())


class MaxPitch:
    """The largest absolute pitch, 10 ms apart [rad]."""

    name: ClassVar[str] = "max_pitch"
    heading: ClassVar[str] = "largest pitch [rad]"
    digits: ClassVar[int] = 2
    reached_only: ClassVar[bool] = False

    def __init__(self) -> None:
        self.value = 0.0

    def add(self, t: Transition) -> None:
        """Look at the poses of one decision, the one before it included."""
        self.value = max(self.value, float(np.abs(t.path[:, 2]).max()))
