"""Sensors, which perceive the ground and the posture of the robot.

The true ground is a ``Profile``; the sensed ground is a ``SensedGround``. A sensor is a plugin: its
fields are settings below ``perception``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from flipperctl.api.plugin import Plugin, register
from flipperctl.api.values import FloatArray, ObservationLayout, Profile, RobotState


@dataclass(frozen=True)
class SensedGround:
    """The sensed ground around the robot, in frame L."""

    points: FloatArray
    """(P, 2) sensed points, and those ``filled``, x never decreasing [m]."""
    heights: FloatArray
    """(N,) mean height of each bin (paper Eq. 1) [m]."""
    filled: NDArray[np.bool_] | None = None
    """(P,) whether a point stands where the ground was never seen; None: every point was seen."""


@dataclass(frozen=True)
class SensedAngles:
    """The sensed posture of the robot."""

    front: float
    """Angle of the front flippers in frame R [rad]."""
    rear: float
    """Angle of the rear flippers in frame R [rad]."""
    pitch: float
    """Pitch of the chassis, nose up positive [rad]."""


class GroundSensor(Protocol):
    """A sensor in use on the ground of one episode."""

    def sense(
        self, state: RobotState, rng: np.random.Generator
    ) -> tuple[SensedGround, SensedAngles]:
        """Sense ground and posture from the robot's true state; noise is drawn from ``rng``."""


class Sensor(ObservationLayout, Plugin, ABC):
    """Perceives the ground in the layout of the observation."""

    kind: ClassVar[str] = "perception"
    not_sampled: ClassVar[frozenset[str]] = frozenset(ObservationLayout.model_fields)
    delay: float = Field(0.0, ge=0, le=0.5, description="age of the perception at a decision [s]")

    @abstractmethod
    def over(self, profile: Profile, margin: float) -> GroundSensor:
        """Return the sensor in use on the ground of one episode.

        ``margin``: length of the level ground before and past the profile that may come into
        view [m].
        """

    def exact(self) -> Sensor:
        """Return this sensor without errors, in the same layout; a privileged teacher perceives so.

        Of a sensor whose defaults are not exact, this method must be overridden.
        """
        return type(self)(**self.layout.model_dump())

    @property
    def layout(self) -> ObservationLayout:
        """Layout of the observation, without the sensor's own settings."""
        return ObservationLayout(bins=self.bins, bin_width=self.bin_width)


SensorT = TypeVar("SensorT", bound=Sensor)


def sensor(name: str) -> Callable[[type[SensorT]], type[SensorT]]:
    """Register a ``Sensor``; choose it with ``perception=<name>``."""
    return register(Sensor, name)
