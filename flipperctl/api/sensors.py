"""Sensors, which perceive the ground and the posture of the robot.

The true ground is a ``Profile``; the sensed ground is a ``SensedGround``. A sensor is a plugin: its
fields are settings below ``perception``. A sensor that senses once for each decision, from the true
state, implements ``over``. Every other sensor has two parts: instruments, which measure in
simulation, and an estimator, which uses only their measurements and runs on a robot too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar

import numpy as np
from pydantic import Field

from flipperctl.api.engines import CameraWorld, RayWorld
from flipperctl.api.plugin import Plugin, register
from flipperctl.api.profile import Profile
from flipperctl.api.values import ObservationLayout, RobotGeometry, RobotState
from flipperctl.core.sensing import Estimator, SensedAngles, SensedGround

if TYPE_CHECKING:
    from flipperctl.core.lidar.ground import Lidar


class GroundSensor(Protocol):
    """A sensor on the ground of one episode, which senses once for each decision."""

    def sense(
        self, state: RobotState, rng: np.random.Generator
    ) -> tuple[SensedGround, SensedAngles]:
        """Sense ground and posture from the robot's true state; noise is drawn from ``rng``."""


@dataclass(frozen=True)
class Mounting:
    """The robot, ground and world on which the instruments of one episode are mounted."""

    robot: RobotGeometry
    """The robot with the values sampled for the episode."""
    profile: Profile
    """True ground of the episode."""
    margin: float
    """Length of the level ground before and past the profile that may come into view [m]."""
    rays: RayWorld
    """Casts rays in the engine's world; raises ``ConfigError`` if the engine casts no rays."""
    rng: np.random.Generator
    """Generator of values that are constant within an episode, such as a bias."""
    gravity: float = 9.81
    """Downward acceleration in the engine's world [m/s²]."""
    cameras: CameraWorld | None = None
    """The robot's cameras; raises ``ConfigError`` if the engine has none. None: in checks that
    have no engine."""


class Instrument(ABC):
    """Measures during one episode, like a device on the robot."""

    period: float | None = None
    """Time between two measurements, a whole multiple of ``SAMPLE_PERIOD`` [s]; the first one is at
    the start. None: once for each decision, at the perceived instant."""

    @abstractmethod
    def measure(self, state: RobotState, rng: np.random.Generator) -> object:
        """Return a measurement of the true state: a frozen dataclass of numbers and arrays.

        None: there is none now, as of a LiDAR in the middle of a turn.

        Noise is sampled from ``rng``, the instrument's own generator, which snapshots include.
        """

    def save(self) -> Any:
        """Return a snapshot of the state, which later measurements do not change.

        An instrument without state needs neither ``save`` nor ``load``.
        """
        return None

    def load(self, saved: Any) -> None:  # noqa: B027  # an instrument may have no state
        """Restore a snapshot."""


class Sensor(ObservationLayout, Plugin):
    """Perceives the ground in the layout of the observation.

    It implements either ``over``, or ``instruments`` and ``estimator``.
    """

    kind: ClassVar[str] = "perception"
    not_sampled: ClassVar[frozenset[str]] = frozenset(ObservationLayout.model_fields)
    delay: float = Field(0.0, ge=0, le=0.5, description="age of the perception at a decision [s]")

    # One call for each decision, from the true state: in simulation alone.
    def over(self, profile: Profile, margin: float) -> GroundSensor:
        """Return a sensor for the ground of one episode.

        ``margin``: length of the level ground before and past the profile that may come into
        view [m].
        """
        raise TypeError(f"sensor {type(self).__name__} measures by its instruments only")

    def mounted(self, mounting: Mounting) -> GroundSensor:
        """Return the sensor of one episode: ``over`` the ground, unless it needs more than that."""
        return self.over(mounting.profile, mounting.margin)

    # Or instruments, which simulation alone has, and an estimator, which a robot runs, too.
    def instruments(self, mounting: Mounting) -> Mapping[str, Instrument] | None:
        """Return the instruments of one episode by name; None: the sensor implements ``over``."""
        return None

    def estimator(self, robot: RobotGeometry) -> Estimator:
        """Return a new estimator for the measurements of ``instruments``.

        It may use what a robot's computer knows: these settings and the nominal ``robot``.
        """
        raise TypeError(f"sensor {type(self).__name__} has no estimator")

    def exact(self) -> Sensor:
        """Return this sensor without errors, in the same layout, for privileged teachers.

        Override it in a sensor whose defaults are not exact.
        """
        return type(self)(**self.layout.model_dump())

    @property
    def lidar(self) -> Lidar | None:
        """What a robot's controller has to know if the estimator maps the scans of a LiDAR.

        It is in exported files, and recordings of a robot are read by it. None: there is no map.
        """
        return None

    @property
    def without_effect(self) -> frozenset[str]:
        """Names of the settings that change nothing, given the others."""
        return frozenset()

    @property
    def layout(self) -> ObservationLayout:
        """Layout of the observation, without the sensor's own settings."""
        return ObservationLayout(**{n: getattr(self, n) for n in ObservationLayout.model_fields})


SensorT = TypeVar("SensorT", bound=Sensor)


def sensor(name: str) -> Callable[[type[SensorT]], type[SensorT]]:
    """Register a ``Sensor``; choose it with ``perception=<name>``.

    Raises:
        ValueError: the name is not valid or is already taken.
        TypeError: the class is not a ``Sensor``, or implements neither ``over`` nor
            ``instruments`` and ``estimator``.
    """
    return register(Sensor, name, _check_parts)


def _check_parts(cls: type[Sensor], where: str) -> None:
    whole = cls.over is not Sensor.over
    parts = cls.instruments is not Sensor.instruments and cls.estimator is not Sensor.estimator
    if not (whole or parts):
        raise TypeError(
            f"{where}: {cls.__name__} needs a method over(profile, margin), or both "
            "instruments(mounting) and estimator(robot)"
        )
