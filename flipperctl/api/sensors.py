"""Sensors: what a robot perceives of the ground and of itself.

The true ground is a ``Profile``; what was sensed of it is a ``SensedGround``. A sensor is a plugin:
its fields are settings below ``perception``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol, TypeVar

import numpy as np
from pydantic import Field

from flipperctl.api.plugin import Plugin, register
from flipperctl.api.values import FloatArray, ObservationLayout, Profile, RobotState


@dataclass(frozen=True)
class SensedGround:
    """What is known of the ground around the robot, in frame L."""

    points: FloatArray
    """(P, 2) sensed points, x never decreasing [m]."""
    heights: FloatArray
    """(N,) mean height of each bin (paper Eq. 1) [m]."""


@dataclass(frozen=True)
class SensedAngles:
    """What is known of the robot's own posture."""

    front: float
    """Front flippers in frame R [rad]."""
    rear: float
    """Rear flippers in frame R [rad]."""
    pitch: float
    """Nose up positive [rad]."""


class GroundSensor(Protocol):
    """A sensor in one episode, on one piece of ground."""

    def sense(
        self, state: RobotState, rng: np.random.Generator
    ) -> tuple[SensedGround, SensedAngles]:
        """Sense the ground and the posture from a true state; noise comes from ``rng``."""


class Sensor(ObservationLayout, Plugin, ABC):
    """Perceives the ground, as the layout of the observation asks for it."""

    kind: ClassVar[str] = "perception"
    delay: float = Field(
        0.0, ge=0, le=0.5, description="age of all that is perceived at a decision [s]"
    )

    @abstractmethod
    def over(self, profile: Profile, margin: float) -> GroundSensor:
        """Return the sensor on a piece of ground.

        ``margin``: level ground before and past the profile that may come into view [m].
        """

    @property
    def layout(self) -> ObservationLayout:
        """What the numbers of an observation are, without the sensor's own settings."""
        return ObservationLayout(bins=self.bins, bin_width=self.bin_width)


SensorT = TypeVar("SensorT", bound=Sensor)


def sensor(name: str) -> Callable[[type[SensorT]], type[SensorT]]:
    """Register a ``Sensor``; choose it with ``perception=<name>``."""
    return register(Sensor, name)
