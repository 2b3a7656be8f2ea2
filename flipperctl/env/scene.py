"""One instant of an episode as plain data: numbers, arrays and names.

A scene holds everything that a picture needs and nothing that changes later, so that it can be
stored, pickled for another process, or sent as JSON.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Outcome, Perception, RobotGeometry, RobotState

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
    action: tuple[int, int] | None = None
    """Last action (front, rear); None before the first."""
    outcome: Outcome | None = None
    """How the episode ended; None while it runs."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data that JSON can hold; arrays become lists."""
        return {**_plain_fields(self), "robot": self.robot.model_dump(mode="json")}


def _plain_fields(value: Any) -> dict[str, Any]:
    return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}


def _plain(value: Any) -> Any:
    match value:
        case np.ndarray() | np.generic():
            return value.tolist()
        case Outcome():
            return value.value
        case tuple():
            return list(value)
        case RobotState() | Perceived():
            return _plain_fields(value)
    return value
