"""The values that plugins receive: geometry, ground, states, perceptions and transitions."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from flipperctl.api.surface import Surface
from flipperctl.core import observation
from flipperctl.core.actions import PAIRS, ActionTable
from flipperctl.core.arrays import FloatArray

MAX_HISTORY = 32
"""Largest number of observations in ``Perception.recent`` [-]."""


class Settings(BaseModel):
    """Frozen settings; unknown keys, NaN and infinity are errors."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        arbitrary_types_allowed=True,
        validate_default=True,
    )
    not_sampled: ClassVar[frozenset[str]] = frozenset()
    """Names of the settings that ``randomise`` must not sample, since policies rely on them."""

    @classmethod
    def nearest_allowed(cls, name: str, value: float) -> float:
        """Return the value nearest to ``value`` that the setting ``name`` can have.

        ``randomise`` samples from a continuous range and calls this for each sample. Override it
        for a setting that allows only some numbers; integers are rounded anyway.
        """
        return value


class RobotGeometry(Settings):
    """Side-view geometry of a chassis with a front and a rear flipper pair (paper Sec. IV)."""

    chassis_length: float = Field(
        0.76, gt=0.2, le=3, description="overall length of the chassis, round ends included [m]"
    )
    flipper_length: float = Field(
        0.536, gt=0.2, le=2, description="overall length of a flipper, round ends included [m]"
    )
    track_radius: float = Field(
        0.1, gt=0.01, lt=0.5, description="radius of the tracks' round ends [m]"
    )
    angle_limit: float = Field(
        math.pi / 3, gt=0, le=math.pi / 2, description="largest flipper angle, both ways [rad]"
    )
    angle_step: float = Field(
        math.pi / 12, gt=0, le=math.pi / 2, description="flipper turn of one action [rad]"
    )

    @model_validator(mode="after")
    def _round_ends_fit(self) -> Self:
        for name in ("chassis_length", "flipper_length"):
            length = getattr(self, name)
            if length <= 2 * self.track_radius:
                raise ValueError(
                    f"{name} ({length:g} m) must exceed twice track_radius "
                    f"({self.track_radius:g} m), since it includes two round ends"
                )
        return self

    @property
    def actions(self) -> ActionTable:
        """The actions of the policy, by the names of the joints that they turn."""
        return PAIRS

    @property
    def hinge_offset(self) -> float:
        """Distance of each flipper hinge from the chassis centre, along the chassis [m]."""
        return self.chassis_length / 2 - self.track_radius

    @property
    def flipper_axle(self) -> float:
        """Distance from the hinge to the centre of the flipper's tip arc [m]."""
        return self.flipper_length - 2 * self.track_radius

    def clip(self, angle: float) -> float:
        """Return the angle limited to the range of the flippers [rad]."""
        return min(self.angle_limit, max(-self.angle_limit, angle))


@dataclass(frozen=True)
class Profile:
    """The obstacle in the robot's side plane, from its first edge to its last.

    ``points`` is (V, 2) [m]: x never decreases, two points of equal x are a vertical face.
    The ground is level before the first point and past the last. ``label`` names the generated
    terrain in tables; if it is empty, they show the terrain's own name. ``surface`` is the ground
    beside the line, if it is known; without it, the profile is extruded to both sides.

    Raises:
        ValueError: if the points are empty, not finite, not (V, 2), or x decreases.
    """

    points: FloatArray
    label: str = ""
    surface: Surface | None = None

    def __init__(
        self,
        points: ArrayLike | Sequence[tuple[float, float]],
        label: str = "",
        surface: Surface | None = None,
    ) -> None:
        array = np.array(points, dtype=np.float64)
        if array.size == 0:
            raise ValueError("a profile needs at least one point; it is empty")
        if array.ndim != 2 or array.shape[1] != 2:
            raise ValueError(f"a profile is (V, 2) points of x and z; the shape is {array.shape}")
        if not np.isfinite(array).all():
            bad = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
            raise ValueError(f"profile point {bad} is not finite: {tuple(array[bad].tolist())}")
        drops = np.flatnonzero(np.diff(array[:, 0]) < 0)
        if drops.size:
            i = int(drops[0])
            raise ValueError(
                f"x decreases from {array[i, 0]:g} to {array[i + 1, 0]:g} m "
                f"between profile points {i} and {i + 1}; it must never decrease"
            )
        array.setflags(write=False)
        object.__setattr__(self, "points", array)
        object.__setattr__(self, "label", label)
        object.__setattr__(self, "surface", surface)

    @property
    def start(self) -> float:
        """World x of the first edge [m]."""
        return float(self.points[0, 0])

    @property
    def end(self) -> float:
        """World x of the last edge [m]."""
        return float(self.points[-1, 0])

    def extended(self, before: float, after: float) -> FloatArray:
        """Return the polyline with level ground of these lengths added, (V + 2, 2) [m]."""
        first, last = self.points[0], self.points[-1]
        return np.vstack([[first[0] - before, first[1]], self.points, [last[0] + after, last[1]]])

    def height(self, x: float) -> float:
        """Return the height of the ground at x, at a vertical face that of its top [m]."""
        points = self.points
        right = int(np.searchsorted(points[:, 0], x, side="right"))
        left = int(np.searchsorted(points[:, 0], x, side="left"))
        if left < right:
            return float(points[left:right, 1].max())
        if right == 0 or right == len(points):
            return float(points[0 if right == 0 else -1, 1])
        (x0, z0), (x1, z1) = points[right - 1], points[right]
        return float(z0 + (z1 - z0) * (x - x0) / (x1 - x0))

    def sample(self, spacing: float, margin: float) -> FloatArray:
        """Return points along the outline, vertical faces included, (P, 2) in world [m].

        The points are ``spacing`` [m] apart and their x never decreases; ``margin`` [m] of level
        ground is added on both sides.
        """
        line = self.extended(margin, margin)
        lengths = np.hypot(*np.diff(line, axis=0).T)  # (V + 1,) [m]
        along = np.concatenate([[0.0], np.cumsum(lengths)])
        at = np.arange(0.0, along[-1], spacing)
        return np.column_stack([np.interp(at, along, line[:, 0]), np.interp(at, along, line[:, 1])])

    @cached_property
    def cloud(self) -> FloatArray:
        """Points every 0.02 m of the outline with 3 m of level ground on both sides, (P, 2) [m]."""
        return self.sample(0.02, 3.0)

    def around(self, x: float, reach: float) -> FloatArray:
        """Return the points of ``cloud`` within ``reach`` [m] of x, (P', 2) in world [m]."""
        along = self.cloud[:, 0].data  # a memoryview, which is faster for bisect
        return self.cloud[bisect_left(along, x - reach) : bisect_left(along, x + reach)]


class Outcome(StrEnum):
    """How an episode ends."""

    REACHED = "reached"
    OVERTURNED = "overturned"
    STUCK = "stuck"
    TIMEOUT = "timeout"


@dataclass(frozen=True)
class RobotState:
    """The robot at one instant."""

    position: FloatArray
    """World coordinates (x, z) of the chassis centre, (2,) [m]."""
    pitch: float
    """Pitch of the chassis, nose up positive [rad]."""
    front: float
    """Angle of the front flippers in frame R, above the chassis positive [rad]."""
    rear: float
    """Angle of the rear flippers in frame R, above the chassis positive [rad]."""
    velocity: FloatArray
    """Velocity (x, z) of the chassis centre in world, (2,) [m/s]."""
    pitch_rate: float
    """Angular velocity of the chassis, nose up positive [rad/s]."""
    time: float
    """Time since the start of the episode [s]."""
    roll: float = 0.0
    """Roll of the chassis, left side up positive; 0 in an engine of the side plane [rad]."""
    yaw: float = 0.0
    """Heading of the chassis from the x axis, to the left positive [rad]."""
    side: float = 0.0
    """World y of the chassis centre, to the left positive [m]."""


class ObservationLayout(Settings):
    """Layout of the N + 3 numbers of an observation (paper Eqs. 1 and 2).

    They are N mean heights of the ground in frame L [m], then front and rear flipper angle and
    pitch [rad].
    """

    bins: int = Field(15, ge=3, le=101, description="N, terrain heights in an observation [-]")
    bin_width: float = Field(
        0.15, gt=0.01, le=1, description="d, width of a bin; the paper gives no number [m]"
    )

    @property
    def size(self) -> int:
        """Length of an observation, N + 3 [-]."""
        return observation.size(self.bins)

    @property
    def reach(self) -> float:
        """Half the length of the perceived ground [m]."""
        return observation.reach(self.bins, self.bin_width)

    @property
    def scale(self) -> FloatArray:
        """Typical magnitude of each number, by which networks divide, (N + 3,) in SI units."""
        return observation.scale(self.bins)


@dataclass(frozen=True)
class Perception:
    """All that a policy may know when it decides: the sensed terrain points and angles.

    The configuration's ``perception`` sets their accuracy.
    """

    observation: NDArray[np.float32]
    """The observation in the order of ``layout``, (N + 3,) in SI units."""
    points: FloatArray
    """Sensed and ``filled`` terrain points in frame L, x never decreasing, (P, 2) [m]."""
    pitch: float
    """Sensed pitch of the chassis, nose up positive [rad]."""
    front: float
    """Sensed angle of the front flippers in frame R [rad]."""
    rear: float
    """Sensed angle of the rear flippers in frame R [rad]."""
    robot: RobotGeometry
    layout: ObservationLayout
    rng: np.random.Generator
    """Generator for random policies, seeded by the episode."""
    recent: tuple[NDArray[np.float32], ...]
    """The newest observations of the episode, ``observation`` last, at most ``MAX_HISTORY``."""
    filled: NDArray[np.bool_] | None = None
    """(P,) whether a point fills unseen ground; None: every point was seen."""
    friction: float | None = None
    """Friction between track and ground, known in exact perception only; None: unknown [-]."""


@dataclass(frozen=True)
class Transition:
    """One decision, from which reward terms and measures are computed."""

    before: RobotState
    after: RobotState
    pitches: FloatArray
    """Pitch at each decision of the episode so far, from the start to ``after``, (T,) [rad]."""
    action: tuple[int, int]
    """Turns (front, rear) of the flipper pairs, each in {-1, 0, 1}."""
    profile: Profile
    robot: RobotGeometry
    outcome: Outcome | None = field(default=None)
    """How the episode ended; None while it runs."""
    path: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    """Poses of the chassis from ``before`` to ``after``, (S + 1, 3): x [m], z [m], pitch [rad]."""
    previous_action: tuple[int, int] = (0, 0)
    """Action of the previous decision; (0, 0) at the first decision of an episode."""
    flippers: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    """Front and rear flipper angle in frame R at each pose of ``path``, (S + 1, 2) [rad]."""
    sample_period: float = 0.01
    """Time between two poses of ``path`` [s]."""
