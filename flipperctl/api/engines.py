"""Engines, which simulate one robot on one piece of ground.

The environment places a robot, commands its flippers, advances the simulation and reads states; it
knows no engine by name. An engine is a plugin like any other: its fields are settings below
``sim``.
"""

from __future__ import annotations

import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from flipperctl.api.plugin import Plugin, register
from flipperctl.api.profile import Profile
from flipperctl.api.robot import Robot
from flipperctl.api.values import Outcome, RobotState
from flipperctl.core import FloatArray
from flipperctl.core.targets import Flippers

SAMPLE_PERIOD = 0.01
"""Time between two samples of the pose, from which the 100 Hz θ̂_R is measured [s]."""


def is_over(
    x: float,
    z: float,
    pitch: float,
    angle: float,
    finish: float,
    top: float,
    half: float,
    slope: float,
    end: float,
    level: float,
) -> bool:
    """Return whether a chassis at (x, z) [m] with ``pitch`` [rad] has reached a limit.

    The other arguments are the fields of ``Limits``, as plain numbers so that it can be compiled.
    """
    if abs(pitch) >= angle:
        return True
    if x < finish:
        return False
    # The allowed height follows the slope, down to the level ground past the last edge.
    lowest = level if x >= end else min(level, top)
    return z + half * abs(math.sin(pitch)) <= max(top + slope * (x - finish), lowest)


class Limits(NamedTuple):
    """Where a run stops: at the pitch ``angle``, or past ``x`` with both ends not above ``top``."""

    angle: float = math.inf
    """Absolute pitch of the chassis [rad]."""
    x: float = math.inf
    """World x of the chassis centre [m]."""
    top: float = math.inf
    """World z of the higher end of the chassis [m]."""
    half: float = 0.0
    """Distance from the chassis centre to each end [m]."""
    slope: float = 0.0
    """Rise of ``top`` for each metre past ``x``, where a run ends on a slope [-]."""
    end: float = math.inf
    """World x past which the ground is level, where a run ends on a slope [m]."""
    level: float = -math.inf
    """``top`` of the level ground, which is enough past ``end``; before it the allowed height does
    not sink below the lower one of both [m]."""

    def reached(self, x: float, z: float, pitch: float) -> bool:
        """Return whether a chassis at (x, z) [m] with ``pitch`` [rad] has reached a limit."""
        return is_over(x, z, pitch, *self)


NO_LIMITS = Limits()
"""Limits that no run reaches."""


class Start(NamedTuple):
    """Start pose of an episode, in which the robot rests on the ground.

    An engine may ignore ``height`` and ``pitch``; it then starts on level ground only, and
    ``episode.run_up`` below 0 is refused.
    """

    x: float
    """World x of the chassis centre [m]."""
    front: float = 0.0
    """Angle of the front flippers in frame R [rad]."""
    rear: float = 0.0
    """Angle of the rear flippers in frame R [rad]."""
    height: float | None = None
    """World z of the chassis centre [m]; None: the robot rests level on the ground below it."""
    pitch: float = 0.0
    """Pitch of the chassis, nose up positive [rad]."""


class World(Protocol):
    """The simulation of one robot on one piece of ground, made for one episode."""

    @property
    def position(self) -> tuple[float, float]:
        """World coordinates (x, z) of the chassis centre [m]."""

    @property
    def pitch(self) -> float:
        """Pitch of the chassis, nose up positive [rad]."""

    # Driving.
    def command(self, front: float, rear: float, /) -> None:
        """Set the target angles of the flippers in frame R [rad].

        A world that moves four flippers alone takes four angles, in the order of
        ``RobotState.flippers``. End stops hold the flippers within ``robot.angle_limit``, whatever
        is commanded.
        """

    def advance(self, samples: int, limits: Limits = NO_LIMITS) -> FloatArray:
        """Simulate up to ``samples`` sample periods; return the pose at the end of each.

        The poses are (S, 3 + J): x [m], z [m], pitch and the angle of each joint [rad]. The run
        stops after the sample at which the chassis reaches a limit or an ``EndingWorld``
        terminates.
        """

    # Reading the world.
    def state(self) -> RobotState:
        """Return the current state."""

    def penetration(self) -> float:
        """Return the largest depth by which the robot overlaps the ground [m]."""

    # Snapshots, for policies that look ahead.
    def save(self) -> Any:
        """Return a snapshot of the changing state for ``load``."""

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""


@runtime_checkable
class EndingWorld(Protocol):
    """A ``World`` with a termination of its own, such as when the robot rolls over sideways."""

    def ended(self) -> Outcome | None:
        """Return the outcome if the world has terminated, else None.

        ``advance`` stops after the sample at which it terminates.
        """


@runtime_checkable
class DrawingWorld(Protocol):
    """A ``World`` that draws pictures of itself."""

    def draw(self, width: int, height: int) -> NDArray[np.uint8]:
        """Return a picture of the current state, (H, W, 3)."""


View = Literal["front", "rear"]
"""A camera of the robot: at its front, looking ahead, or at its rear, looking back."""


@dataclass(frozen=True)
class CameraImage:
    """What a camera shows; the first row is at the top."""

    pixels: NDArray[np.uint8]
    """Colours, (H, W, 3)."""
    depth: NDArray[np.float32]
    """Distance along the camera's axis, infinite where nothing is, (H, W) [m]."""


@runtime_checkable
class CameraWorld(Protocol):
    """A ``World`` with cameras on the robot."""

    def look(self, view: View, width: int, height: int) -> CameraImage:
        """Return what a camera of the robot shows now, ``height`` × ``width`` pixels.

        Raises:
            RequestError: the machine lacks a library that the engine needs for drawing.
        """


@runtime_checkable
class BeltWorld(Protocol):
    """A ``World`` whose belts can be slowed, stopped and reversed."""

    def run_belts(self, share: float) -> None:
        """Run all belts at a share of ``robot.track_speed``, from -1 to 1; at the start it is 1.

        A snapshot need not contain it.
        """


@runtime_checkable
class RayWorld(Protocol):
    """A ``World`` in which sensors cast rays."""

    def cast_rays(self, origin: FloatArray, directions: FloatArray, reach: float) -> FloatArray:
        """Return the distance from ``origin`` to the ground along each direction, (R,) [m].

        It is infinite where no ground is hit within ``reach`` [m]; the robot itself is never hit.
        ``origin`` is (3,) [m] and ``directions`` are (R, 3) unit vectors, both in world: x forward,
        y to the left, z up.
        """


@runtime_checkable
class PoweredWorld(Protocol):
    """A ``World`` that measures the work of its flippers' motors."""

    def flipper_work(self) -> float:
        """Return the integral of all motors' absolute power since the start [J]: torque × speed.

        It never decreases; a snapshot need not contain it.
        """


@runtime_checkable
class RollingWorld(Protocol):
    """A ``World`` in three dimensions, which measures how its chassis rolls."""

    def roll_variation(self) -> float:
        """Return the sum of the absolute roll changes from sample to sample since the start [rad].

        It never decreases; a snapshot need not contain it.
        """


SharedSetting = Literal["friction", "gravity", "roll_limit"]
"""A setting with the same meaning in every engine that has it: friction between track and ground
[-], downward acceleration [m/s²], absolute roll from which the robot is overturned [rad]."""


class Engine(Plugin, ABC):
    """Simulates the robot; equal arguments, ``rng`` included, give bit-identical worlds.

    The names of ``SharedSetting`` are reserved for settings with that meaning and unit. A setting
    ``substep`` is a time step [s]; ``SAMPLE_PERIOD`` must be a whole multiple of it.
    """

    kind: ClassVar[str] = "sim"
    without_effect: ClassVar[frozenset[str]] = frozenset()
    """Names of the settings that change the speed of a simulation but not its results."""
    flippers: ClassVar[tuple[Flippers, ...]] = ("pairs",)
    """Values of ``robot.flippers`` that its worlds can move."""

    @abstractmethod
    def place(
        self, profile: Profile, robot: Robot, start: Start, rng: np.random.Generator
    ) -> World:
        """Return a world with the robot on the ground; its samples are ``SAMPLE_PERIOD`` apart.

        Quantities of the engine that vary between episodes, such as a heading, are sampled from
        ``rng``. All worlds of an episode are placed with equal generators.
        """

    def shared_setting(self, name: SharedSetting) -> float | None:
        """Return the value of a setting that engines share; None for an engine without it.

        Privileged controllers are given the friction, and other engines are set up with equal
        values. Override it if the engine has the value under another name.
        """
        return getattr(self, name, None)

    @classmethod
    def nearest_allowed(cls, name: str, value: float) -> float:
        """Return the nearest divisor of ``SAMPLE_PERIOD`` for ``substep``, else ``value``."""
        if name == "substep" and value > 0:
            # A whole number of substeps in each sample.
            return SAMPLE_PERIOD / max(1, round(SAMPLE_PERIOD / value))
        return value

    def versions(self) -> dict[str, str]:
        """Return the versions of the libraries that affect the results, for checkpoints."""
        return {}


EngineT = TypeVar("EngineT", bound=Engine)


def engine(name: str) -> Callable[[type[EngineT]], type[EngineT]]:
    """Register an ``Engine``; choose it with ``sim=<name>``.

    Raises:
        ValueError: the name is not valid or is already taken.
        TypeError: the class is not an ``Engine``, or its ``place`` takes no generator.
    """
    return register(Engine, name, _check_place)


def _check_place(cls: type[Engine], where: str) -> None:
    place = inspect.signature(cls.place)
    try:
        place.bind("self", "profile", "robot", "start", "rng")
    except TypeError:
        raise TypeError(
            f"{where}: {cls.__name__}.place({', '.join(place.parameters)}) cannot be called as "
            "place(profile, robot, start, rng); add the parameter rng, the generator of values "
            "that vary between episodes"
        ) from None
