"""The whole contract for plugin authors: the values, the plugin families and their decorators.

In: nothing of the rest of flipperctl. Out: everything that a plugin may import.
SI units and radians throughout. Frames: world (x forward, z up, the profile's own
coordinates), L (origin at the chassis centre, level), R (origin at the chassis centre, x along
the chassis). Signs: a flipper angle is positive when the flipper is above the chassis, front
and rear alike; the pitch is positive nose up.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    SerializationInfo,
)
from pydantic_core import PydanticCustomError

if TYPE_CHECKING:
    import torch

__all__ = [
    "ACTIONS",
    "MEMORY",
    "AnyTerrain",
    "Controller",
    "Network",
    "ObservationLayout",
    "Outcome",
    "Perception",
    "Plugin",
    "Profile",
    "RewardTerm",
    "RobotGeometry",
    "RobotState",
    "Settings",
    "Shaping",
    "Simulator",
    "Terrain",
    "Transition",
    "action_index",
    "candidate_angle",
    "controller",
    "network",
    "reward",
    "terrain",
]

FloatArray = NDArray[np.float64]

ACTIONS: tuple[tuple[int, int], ...] = tuple((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1))
"""Action index → (front, rear); +1 raises the pair by one angle step (paper Eq. 3)."""

MEMORY = 32
"""Observations that ``Perception.recent`` holds at most."""


def action_index(front: int, rear: int) -> int:
    """Index of the action that turns the pairs by ``front`` and ``rear`` in {-1, 0, 1}."""
    return 3 * (front + 1) + (rear + 1)


class Settings(BaseModel):
    """Frozen settings; unknown keys, NaN and infinity are errors."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        arbitrary_types_allowed=True,
        validate_default=True,
    )


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

    @property
    def hinge_offset(self) -> float:
        """Distance of each flipper hinge from the chassis centre, along the chassis [m]."""
        return self.chassis_length / 2 - self.track_radius

    @property
    def flipper_axle(self) -> float:
        """Distance from the hinge to the centre of the flipper's tip arc [m]."""
        return self.flipper_length - 2 * self.track_radius

    def clip(self, angle: float) -> float:
        """The angle limited to what a flipper can reach [rad]."""
        return min(self.angle_limit, max(-self.angle_limit, angle))


@dataclass(frozen=True)
class Profile:
    """The obstacle in the robot's side plane, from its first edge to its last.

    ``points`` is (V, 2) [m]: x never decreases, two points of equal x are a vertical face.
    The ground goes on level before the first point and behind the last. ``label`` says what was
    drawn, for tables; empty stands for the terrain's own name.

    Raises:
        ValueError: if the points are empty, not finite, not (V, 2), or x decreases.
    """

    points: FloatArray
    label: str = ""

    def __init__(self, points: ArrayLike | Sequence[tuple[float, float]], label: str = "") -> None:
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
                f"between profile points {i} and {i + 1}; it may only grow or stay"
            )
        array.setflags(write=False)
        object.__setattr__(self, "points", array)
        object.__setattr__(self, "label", label)

    @property
    def start(self) -> float:
        """X of the first edge [m]."""
        return float(self.points[0, 0])

    @property
    def end(self) -> float:
        """X of the last edge [m]."""
        return float(self.points[-1, 0])

    def extended(self, before: float, behind: float) -> FloatArray:
        """The polyline with level ground added, (V + 2, 2) [m]."""
        first, last = self.points[0], self.points[-1]
        return np.vstack([[first[0] - before, first[1]], self.points, [last[0] + behind, last[1]]])

    def height(self, x: float) -> float:
        """Height of the ground at x; the higher of the two at a vertical face [m]."""
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
        """Points along the outline, vertical faces included, (P, 2) in world [m].

        x never decreases; ``margin`` metres of level ground are added on both sides.
        """
        line = self.extended(margin, margin)
        lengths = np.hypot(*np.diff(line, axis=0).T)  # (V + 1,) [m]
        along = np.concatenate([[0.0], np.cumsum(lengths)])
        at = np.arange(0.0, along[-1], spacing)
        return np.column_stack([np.interp(at, along, line[:, 0]), np.interp(at, along, line[:, 1])])

    @cached_property
    def cloud(self) -> FloatArray:
        """The outline every 0.02 m with 3 m of level ground on both sides, (P, 2) [m]."""
        return self.sample(0.02, 3.0)

    def around(self, x: float, reach: float) -> FloatArray:
        """The points of ``cloud`` within ``reach`` of x, (P', 2) in world [m]."""
        low, high = np.searchsorted(self.cloud[:, 0], (x - reach, x + reach))
        return self.cloud[low:high]


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
    """(2,) chassis centre in world [m]."""
    pitch: float
    """Chassis against level, nose up positive [rad]."""
    front: float
    """Front flipper pair in frame R, above the chassis positive [rad]."""
    rear: float
    """Rear flipper pair in frame R, above the chassis positive [rad]."""
    velocity: FloatArray
    """(2,) of the chassis centre in world [m/s]."""
    pitch_rate: float
    """[rad/s]"""
    time: float
    """Since the start of the episode [s]."""


class ObservationLayout(Settings):
    """What the N + 3 numbers of an observation are (paper Eqs. 1 and 2)."""

    bins: int = Field(15, ge=3, le=101, description="N, terrain heights in an observation [-]")
    bin_width: float = Field(
        0.15, gt=0.01, le=1, description="d, width of a bin; the paper gives no number [m]"
    )

    @property
    def size(self) -> int:
        """Length of an observation."""
        return self.bins + 3

    @property
    def reach(self) -> float:
        """Half the length of the perceived ground [m]."""
        return self.bins * self.bin_width / 2

    @property
    def scale(self) -> FloatArray:
        """Typical magnitude of each number, (N + 3,) in SI units: networks divide by it."""
        return np.concatenate([np.full(self.bins, 0.5), np.full(3, math.pi / 3)])


@dataclass(frozen=True)
class Perception:
    """What a controller may know when it decides: sensed, never the true terrain."""

    observation: NDArray[np.float32]
    """(N + 3,) laid out as ``layout`` says."""
    points: FloatArray
    """(P, 2) sensed terrain points in frame L [m]."""
    pitch: float
    front: float
    rear: float
    robot: RobotGeometry
    layout: ObservationLayout
    rng: np.random.Generator
    """For controllers that draw at random; seeded by the episode."""
    recent: tuple[NDArray[np.float32], ...]
    """The observations of the episode so far, ``observation`` last; at most ``MEMORY``."""


@dataclass(frozen=True)
class Transition:
    """One decision, as reward terms see it."""

    before: RobotState
    after: RobotState
    pitches: FloatArray
    """(T,) pitch at every decision of the episode so far, start and ``after`` included [rad]."""
    action: tuple[int, int]
    """(front, rear) in {-1, 0, 1}."""
    profile: Profile
    robot: RobotGeometry
    outcome: Outcome | None = field(default=None)
    """None while the episode runs."""
    path: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    """(S + 1, 3) x [m], z [m] and pitch [rad] of the chassis every 10 ms, ``before`` included."""
    previous_action: tuple[int, int] = (0, 0)
    """Of the decision before, (0, 0) at an episode's first."""


def candidate_angle(
    points: FloatArray,
    pitch: float,
    robot: RobotGeometry,
    *,
    near: float = 0.1,
    far: float = 0.45,
    rear: bool = False,
) -> float:
    """The flipper angle that just clears the terrain ahead (behind for ``rear``) [rad].

    The largest angle in frame R of the vectors from the hinge to the terrain points inflated by
    the track radius (paper Sec. III-D after Okada et al. 2011): atan2(z, u) + asin(r / distance).
    ``points`` are (P, 2) in frame L [m]; only those between ``near`` and ``far`` of the hinge,
    measured along the chassis, count, since a point under the hinge would outweigh all others.
    Clipped to what the flipper can reach; 0 without points.
    """
    cos, sin = math.cos(pitch), math.sin(pitch)
    along = cos * points[:, 0] + sin * points[:, 1]
    up = cos * points[:, 1] - sin * points[:, 0]
    u = (-along if rear else along) - robot.hinge_offset
    chosen = (u >= near) & (u <= far)
    if not chosen.any():
        return 0.0
    u, up = u[chosen], up[chosen]
    inflation = np.arcsin(np.minimum(1.0, robot.track_radius / np.hypot(u, up)))
    return robot.clip(float((np.arctan2(up, u) + inflation).max()))


class Plugin(Settings):
    """Base of the four families; a plugin's fields are its settings."""

    kind: ClassVar[str]
    plugin_name: ClassVar[str]


class Terrain(Plugin, ABC):
    """Draws the ground of an episode."""

    kind: ClassVar[str] = "terrain"

    @abstractmethod
    def generate(self, rng: np.random.Generator) -> Profile:
        """A profile; every random choice comes from ``rng``."""

    @property
    def first_difficulty(self) -> float:
        """Difficulty of the first episode of a training, 0 to 1."""
        return 1.0

    def next_difficulty(self, difficulty: float, reached: bool) -> float:
        """Difficulty of the episodes behind one that did or did not reach the finish, 0 to 1."""
        return difficulty

    def at(self, difficulty: float) -> Terrain:
        """The terrain from which a training at this difficulty draws; itself is that of 1."""
        return self

    def labelled(self, rng: np.random.Generator) -> Profile:
        """What ``generate`` draws; without a label it gets the terrain's name.

        Raises:
            ValueError: it is no profile.
        """
        profile = self.generate(rng)
        if not isinstance(profile, Profile):
            found = type(profile).__name__
            raise ValueError(f"generate must return a Profile; it returned a {found}")
        return profile if profile.label else Profile(profile.points, self.plugin_name)


def _nested_terrain(value: object) -> object:
    """The terrain meant by its name, or by a mapping with ``name`` and its fields."""
    if isinstance(value, Terrain):
        return value
    if isinstance(value, str):
        value = {"name": value}
    if not isinstance(value, Mapping) or "name" not in value:
        raise ValueError("a terrain's name, or a mapping with 'name' and its fields, is allowed")
    cls = registry.get(("terrain", str(value["name"])))
    if cls is None:
        known = sorted(name for kind, name in registry if kind == "terrain")
        context = {"kind": "terrain", "name": str(value["name"]), "known": known}
        raise PydanticCustomError("unknown_plugin", "there is no {kind} plugin '{name}'", context)
    return cls(**{key: field for key, field in value.items() if key != "name"})


def _nested_container(plugin: Plugin, info: SerializationInfo) -> Any:
    """What ``_nested_terrain`` takes; in the context ``brief`` a name alone if it says it all."""
    context = info.context or {}
    if context.get("brief") and plugin == type(plugin)():
        return plugin.plugin_name
    fields = plugin.model_dump(mode="json", context=context)
    return {"name": plugin.plugin_name, **fields}


AnyTerrain = Annotated[
    Terrain, BeforeValidator(_nested_terrain), PlainSerializer(_nested_container)
]
"""The type of a field that takes another terrain: an instance, a name, or a mapping."""


class RewardTerm(Plugin, ABC):
    """One summand of the reward; the environment multiplies it by ``weight``."""

    kind: ClassVar[str] = "reward"
    bounds: ClassVar[tuple[float, float]] = (-math.inf, math.inf)
    """Least and largest unweighted value; a term at its least is saturated."""
    weight: float = Field(1.0, ge=-1e6, le=1e6, description="factor of the term in the sum [-]")

    @abstractmethod
    def __call__(self, t: Transition) -> float:
        """The unweighted reward of one decision [-]."""


class Shaping(RewardTerm):
    """Potential-based shaping: γ·Φ(after) − Φ(before), and Φ = 0 behind every outcome.

    It leaves every optimal policy optimal (Ng, Harada and Russell 1999): over a whole episode the
    discounted terms add up to −Φ(start), whatever the robot did in between. That holds for the
    discount ``gamma`` alone, and only if nothing is expected behind an outcome; training checks
    both. A subclass writes ``potential``, and ``bounds`` if Φ has any.
    """

    gamma: float = Field(
        0.99, ge=0, lt=1, description="discount per decision, equal to agent.gamma [-]"
    )

    @abstractmethod
    def potential(self, state: RobotState, profile: Profile, robot: RobotGeometry) -> float:
        """Φ, how good it is to be there; a function of the state alone [-]."""

    def __call__(self, t: Transition) -> float:
        """The unweighted shaping of one decision [-]."""
        ahead = 0.0 if t.outcome is not None else self.potential(t.after, t.profile, t.robot)
        return self.gamma * ahead - self.potential(t.before, t.profile, t.robot)


class Network(Plugin, ABC):
    """Builds the Q-network.

    The module may offer more than ``forward``, and is then trained accordingly:

    - ``quantiles(observation)`` → (B, n_actions, K): K equally likely values of each action's
      return, of which ``forward`` gives the mean. They are learnt by quantile regression.
    - ``draw_noise(rng: np.random.Generator)``, of the module or any part of it: takes new noise,
      before each decision of training and each update. The noise acts in ``train()`` mode only; a
      policy is judged and exported in ``eval()`` mode. It lies in buffers that are not persistent.
    """

    kind: ClassVar[str] = "network"

    @property
    def frames(self) -> int:
        """How many of the newest observations the module takes in at once, at most ``MEMORY``.

        Above 1, a row is their N + 3 numbers one after the other, oldest first; at the start of an
        episode the first observation stands in for those that there are not.
        """
        return 1

    @abstractmethod
    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """A module from (B, frames · (N + 3)) in SI units to Q-values (B, n_actions)."""


class Simulator(Protocol):
    """The scene of an episode, for controllers that look ahead; no real robot has one."""

    @property
    def state(self) -> RobotState:
        """The robot now."""

    @property
    def robot(self) -> RobotGeometry:
        """Its geometry."""

    @property
    def speed(self) -> float:
        """Of its belts [m/s]."""

    @property
    def finish(self) -> float:
        """X that the chassis centre must pass [m]."""

    def step(self, action: int) -> Outcome | None:
        """One decision; None while the episode goes on."""

    def save(self) -> Any:
        """The moment, for ``load``."""

    def load(self, saved: Any) -> None:
        """Go back to a moment.

        The engine's contact impulses are not restored, so that a path through loaded moments
        differs a little from the same actions in one go.
        """

    def restart(self) -> None:
        """Back to the start: the same actions now lead to the episode's own states, exactly."""

    def tell(self, share: float) -> None:
        """Say how much of a long search is done, in [0, 1]."""


class Controller(Plugin, ABC):
    """A rule that maps what the robot perceives to an action."""

    kind: ClassVar[str] = "controller"

    def begin(self, simulator: Simulator) -> None:  # for the few that need it
        """An episode begins; ``simulator`` is its scene. Most rules do nothing here."""

    @abstractmethod
    def act(self, p: Perception) -> int:
        """Index into ``ACTIONS``."""


registry: dict[tuple[str, str], type[Plugin]] = {}
"""(kind, name) → class, filled by the decorators when a plugin's module is imported."""


PluginT = TypeVar("PluginT", bound=Plugin)
TerrainT = TypeVar("TerrainT", bound=Terrain)
RewardT = TypeVar("RewardT", bound=RewardTerm)
NetworkT = TypeVar("NetworkT", bound=Network)
ControllerT = TypeVar("ControllerT", bound=Controller)


NAME_RULE = "lower-case letters, digits and _ are allowed, a letter first"


def is_plugin_name(name: str) -> bool:
    """Whether a plugin may be called so."""
    return re.fullmatch(r"[a-z][a-z0-9_]*", name) is not None


def _register(family: type[Any], name: str) -> Callable[[type[PluginT]], type[PluginT]]:
    if not is_plugin_name(name):
        raise ValueError(f"plugin name {name!r}: {NAME_RULE}")

    def decorate(cls: type[PluginT]) -> type[PluginT]:
        if not issubclass(cls, family):
            raise TypeError(f"@{family.kind}({name!r}): {cls.__name__} is no {family.__name__}")
        taken = registry.get((family.kind, name))
        if taken is not None:
            raise ValueError(
                f"two {family.kind} plugins are called {name!r}: "
                f"{taken.__module__}.{taken.__qualname__} and {cls.__module__}.{cls.__qualname__}"
            )
        cls.plugin_name = name
        registry[family.kind, name] = cls
        return cls

    return decorate


def terrain(name: str) -> Callable[[type[TerrainT]], type[TerrainT]]:
    """Register a ``Terrain`` under ``name``; ``terrain=<name>`` then works everywhere."""
    return _register(Terrain, name)


def reward(name: str) -> Callable[[type[RewardT]], type[RewardT]]:
    """Register a ``RewardTerm``; add it with ``+reward@rewards.<term>=<name>``."""
    return _register(RewardTerm, name)


def network(name: str) -> Callable[[type[NetworkT]], type[NetworkT]]:
    """Register a ``Network``; choose it with ``network=<name>``."""
    return _register(Network, name)


def controller(name: str) -> Callable[[type[ControllerT]], type[ControllerT]]:
    """Register a ``Controller``; choose it with ``--controller <name>``."""
    return _register(Controller, name)
