"""Scenes of an episode as plain data, their pictures, and observers.

A scene holds everything that a picture needs and nothing that changes later, so that it can be
stored, pickled for another process, or sent as JSON. The default renderer is the entry point
``side`` of the group ``flipperctl.renderers``, so that the environment imports no plotting code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_jsonable_python

from flipperctl.api import (
    FloatArray,
    Measured,
    Outcome,
    Perception,
    Profile,
    Robot,
    RobotGeometry,
    RobotState,
    Transition,
    World,
)
from flipperctl.env.drive import Drive
from flipperctl.errors import ConfigError
from flipperctl.plugging import plugins

WIDTH, HEIGHT = 960, 480
"""Width and height of a picture [px]."""


@dataclass(frozen=True)
class Perceived:
    """The ground and the posture that the policy perceives."""

    heights: FloatArray
    """Mean height of each bin in frame L, (N,) [m]."""
    bin_width: float
    """Width of a bin [m]."""
    points: FloatArray
    """Sensed and ``filled`` terrain points in frame L, (P, 2) [m]."""
    filled: NDArray[np.bool_] | None
    """(P,) whether a point fills unseen ground; None: every point was seen."""
    front: float
    """Sensed angle of the front flippers in frame R [rad]."""
    rear: float
    """Sensed angle of the rear flippers in frame R [rad]."""
    pitch: float
    """Sensed pitch of the chassis, nose up positive [rad]."""

    @classmethod
    def of(cls, p: Perception) -> Perceived:
        """Return the numbers of a perception."""
        heights = p.observation[: p.layout.bins].astype(np.float64)
        width = p.layout.bin_width
        return cls(heights, width, p.points, p.filled, front=p.front, rear=p.rear, pitch=p.pitch)


@dataclass(frozen=True)
class Scene:
    """One instant of an episode."""

    terrain: str
    """Registered name of the terrain."""
    ground: FloatArray
    """Points of the profile in world, (V, 2) [m]; the ground is level before and past them."""
    start: float
    """World x of the chassis centre at the start, without the random shift [m]."""
    finish: float
    """World x that the chassis centre must pass [m]."""
    track_speed: float
    """Speed of the belts [m/s]."""
    robot: RobotGeometry
    """The robot as policies know it."""
    state: RobotState
    perceived: Perceived
    action: tuple[int, ...] | None = None
    """Turn of each joint by the last action; None before the first."""
    outcome: Outcome | None = None
    """How the episode ended; None while it runs."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data that JSON can hold; arrays become lists."""
        plain: dict[str, Any] = to_jsonable_python(self, fallback=lambda value: value.tolist())
        return plain


MODES = ("rgb_array",)
"""Values of ``render_mode`` besides None."""
GROUP = "flipperctl.renderers"
"""Group of entry points of renderers; each is a class that is made without arguments."""

Picture = NDArray[np.uint8]
Renderer = Callable[[Scene], Picture]
"""Returns a picture of a scene, (HEIGHT, WIDTH, 3)."""


def installed() -> Renderer:
    """Return a new renderer of scenes from the side; ``ConfigError`` if none is installed."""
    if not (renderers := plugins.installed(GROUP)):
        raise ConfigError(
            f"render_mode: no entry point 'side' in the group {GROUP!r}; "
            "reinstall flipperctl (pip install -e .)"
        )
    renderer: Renderer = renderers[0].load()()
    return renderer


class Observer:
    """Observes an episode while it runs; a method that is not overridden does nothing.

    An observer must not change the values that it receives.
    """

    every: int | None = None
    """Samples between two calls of ``stopped`` [-]; None: ``stopped`` is never called."""

    def begin(self, profile: Profile, robot: Robot) -> None:
        """Receive the ground and the robot of a new episode."""

    def moved(self, time: float, poses: FloatArray) -> None:
        """Receive the poses (S, 5) of consecutive samples, the first at ``time`` [s].

        Columns: x [m], z [m], pitch, front and rear flipper angle [rad]. The samples are
        ``SAMPLE_PERIOD`` apart; each is received once, beginning with the start.
        """

    def stopped(self, world: World) -> None:
        """Receive the world at the start and after every ``every`` samples, for pictures.

        The engine then simulates fewer samples per call. States stay bit-identical, except for the
        last digit of the time in an engine that accumulates it.
        """

    def measured(self, measured: Measured) -> None:
        """Receive a measurement of an instrument."""

    def decided(self, t: Transition, p: Perception, rewards: Mapping[str, float]) -> None:
        """Receive a simulated decision.

        ``p``: the perception on which the policy decided; ``rewards``: the weighted value of each
        reward term.
        """


def attach(observers: Iterable[Observer], drive: Drive, profile: Profile) -> None:
    """Connect observers to an episode that begins."""
    for observer in observers:
        observer.begin(profile, drive.robot)
        drive.report_poses(observer.moved)
        if observer.every is not None:
            drive.sample_every(observer.every, observer.stopped)
