"""Engines: what simulates one robot on one piece of ground.

The environment places a robot, commands its flippers, lets time run and reads states; it knows no
engine by name. An engine is a plugin like any other: its fields are settings below ``sim``.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar

from flipperctl.api.plugin import Plugin, register
from flipperctl.api.robot import Robot
from flipperctl.api.values import FloatArray, Profile, RobotState

SAMPLE_PERIOD = 0.01
"""Time between two samples of the pose, at which θ̂_R is measured [s]."""


class Limits(NamedTuple):
    """Where a run stops: at ``angle``, or past ``x`` with both ends not above ``top``."""

    angle: float = math.inf
    """Of the chassis, either way [rad]."""
    x: float = math.inf
    """Of its centre [m]."""
    top: float = math.inf
    """Height of its higher end [m]."""
    half: float = 0.0
    """From its centre to each end [m]."""


NO_LIMITS = Limits()


class Start(NamedTuple):
    """Where an episode begins; the robot rests level on the ground."""

    x: float
    """Of the chassis centre in world [m]."""
    front: float = 0.0
    """Front flippers in frame R [rad]."""
    rear: float = 0.0
    """Rear flippers in frame R [rad]."""


class World(Protocol):
    """One robot on one piece of ground, made for one episode."""

    @property
    def position(self) -> tuple[float, float]:
        """Chassis centre (x, z) in world [m]."""

    @property
    def pitch(self) -> float:
        """Of the chassis, nose up positive [rad]."""

    def command(self, front: float, rear: float) -> None:
        """Set the angles that the flippers turn to, in frame R [rad]."""

    def advance(self, samples: int, limits: Limits = NO_LIMITS) -> FloatArray:
        """Let up to ``samples`` sample periods pass; return the pose at the end of each.

        (S, 5): x [m], z [m], pitch, front and rear flipper angle [rad]. The run stops after the
        sample at which the chassis reaches a limit.
        """

    def state(self) -> RobotState:
        """Return the state now."""

    def penetration(self) -> float:
        """Return how deep the robot is in the ground [m]."""

    def save(self) -> Any:
        """Return a snapshot of all that changes, for ``load``."""

    def load(self, saved: Any) -> None:
        """Return to a snapshot."""


class Engine(Plugin, ABC):
    """Simulates the robot; equal arguments give equal worlds, bit for bit."""

    kind: ClassVar[str] = "sim"
    without_effect: ClassVar[frozenset[str]] = frozenset()
    """Settings that change how fast a world runs, and nothing that comes out."""

    @abstractmethod
    def place(self, profile: Profile, robot: Robot, start: Start) -> World:
        """Put the robot on the ground; samples are ``SAMPLE_PERIOD`` apart."""

    def versions(self) -> dict[str, str]:
        """Return the versions of the libraries that decide what comes out, for checkpoints."""
        return {}


EngineT = TypeVar("EngineT", bound=Engine)


def engine(name: str) -> Callable[[type[EngineT]], type[EngineT]]:
    """Register an ``Engine``; choose it with ``sim=<name>``."""
    return register(Engine, name)
