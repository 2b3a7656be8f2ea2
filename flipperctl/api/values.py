"""The values that plugins receive: geometry, ground, states, perceptions and transitions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ValidationError,
    model_validator,
)
from pydantic_core import core_schema

from flipperctl.api.profile import Profile
from flipperctl.core import FloatArray, observation
from flipperctl.core.targets import JOINTS, Flippers

MAX_HISTORY = 32
"""Largest number of observations in ``Perception.recent`` [-]."""


_NO_SCHEMAS = {"default", "metadata", "config", "serialization"}
"""Parts of a schema whose content is not another one."""


def _no_boolean(value: object) -> object:
    if isinstance(value, bool | np.bool_):
        raise ValueError("a number is allowed, not true or false")
    return value


_NO_BOOLEAN = {"type": "no-info", "function": _no_boolean}


def _without_booleans(schema: Any) -> Any:
    """Return a schema of pydantic in which every number refuses booleans, which Python counts."""
    if isinstance(schema, list | tuple):
        return type(schema)(map(_without_booleans, schema))
    # Defaults and the like hold no schemas; a schema that refuses booleans already stays.
    if not isinstance(schema, dict) or schema.get("function") == _NO_BOOLEAN:
        return schema
    inner: Any = {k: v if k in _NO_SCHEMAS else _without_booleans(v) for k, v in schema.items()}
    if schema.get("type") not in ("int", "float"):
        return inner
    return core_schema.no_info_before_validator_function(_no_boolean, inner)


class Settings(BaseModel):
    """Frozen settings; unknown keys, NaN and infinity are errors."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        arbitrary_types_allowed=True,
        validate_default=True,
    )
    # What ``randomise`` reads of a section of settings.
    not_sampled: ClassVar[frozenset[str]] = frozenset()
    """Names of the settings that ``randomise`` must not sample, since policies rely on them."""

    factors: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    """Factors that ``randomise`` can sample by name, and the settings that each multiplies."""

    added: ClassVar[frozenset[str]] = frozenset()
    """Names of settings that a later version added; hashes of conditions lack their defaults."""

    null_values: ClassVar[Mapping[str, float]] = {}
    """Numbers as which settings count where they are null, such as infinity for no limit."""

    if not TYPE_CHECKING:  # which else would take any attribute for known

        def __setattr__(self, name: str, value: Any) -> None:
            """Refuse to set an attribute; private ones may be set.

            Raises:
                AttributeError: it is a setting, or no attribute at all.
            """
            try:
                super().__setattr__(name, value)
            except ValidationError as error:
                raise AttributeError(
                    f"{type(self).__name__}.{name} cannot be set: settings do not change; keep "
                    "what changes in a local variable, or in an object that build returns"
                ) from error

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        """Return the schema of the settings, whose numbers are never true or false."""
        return _without_booleans(handler(source))

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
    def hinge_offset(self) -> float:
        """Distance of each flipper hinge from the chassis centre, along the chassis [m]."""
        return self.chassis_length / 2 - self.track_radius

    @property
    def flipper_axle(self) -> float:
        """Distance from the hinge to the centre of the flipper's tip arc [m]."""
        return self.flipper_length - 2 * self.track_radius

    @property
    def reach(self) -> float:
        """Distance from the chassis centre to the tip of a level flipper, along the chassis [m]."""
        return self.hinge_offset + self.flipper_axle + self.track_radius

    def clip(self, angle: float) -> float:
        """Return the angle limited to the range of the flippers [rad]."""
        return min(self.angle_limit, max(-self.angle_limit, angle))


class Outcome(StrEnum):
    """How an episode ends."""

    REACHED = "reached"
    OVERTURNED = "overturned"
    STUCK = "stuck"
    TIMEOUT = "timeout"


@dataclass(frozen=True)
class RobotState:
    """The robot at one instant."""

    # Pose.
    position: FloatArray
    """World coordinates (x, z) of the chassis centre, (2,) [m]."""
    pitch: float
    """Pitch of the chassis, nose up positive [rad]."""
    front: float
    """Angle of the front flippers in frame R, above the chassis positive; their mean if each turns
    alone [rad]."""
    rear: float
    """Angle of the rear flippers in frame R, above the chassis positive; their mean [rad]."""
    # Motion.
    velocity: FloatArray
    """Velocity (x, z) of the chassis centre in world, (2,) [m/s]."""
    pitch_rate: float
    """Angular velocity of the chassis, nose up positive [rad/s]."""
    time: float
    """Time since the start of the episode [s]."""
    # In three dimensions; engines of the side plane leave these as they are.
    roll: float = 0.0
    """Roll of the chassis, left side up positive; 0 in an engine of the side plane [rad]."""
    yaw: float = 0.0
    """Heading of the chassis from the x axis, to the left positive [rad]."""
    side: float = 0.0
    """World y of the chassis centre, to the left positive [m]."""
    side_velocity: float = 0.0
    """Velocity of the chassis centre along world y [m/s]."""
    orientation: FloatArray | None = None
    """(3, 3) rotation from frame R to world, where world's z axis need not be vertical; None: by
    roll, pitch and yaw."""
    belts: FloatArray | None = None
    """Speeds of the left and the right belts, (2,) [m/s]; None: both are ``robot.track_speed``."""
    flippers: tuple[float, ...] = ()
    """Angles of four flippers that turn alone, front left, front right, rear left, rear right;
    empty: of pairs [rad]."""


class ObservationLayout(Settings):
    """Layout of the numbers of an observation (paper Eqs. 1 and 2).

    They are N mean heights of the ground in frame L [m], then the N ``highest`` ones, then the
    angles of the flippers, front before rear and left before right, and the pitch [rad]. With
    ``sides``, the same heights below the left and below the right tracks follow the first ones, and
    the roll stands before the angles.
    """

    bins: int = Field(15, ge=3, le=101, description="N, terrain heights in an observation [-]")
    bin_width: float = Field(
        0.15, gt=0.01, le=1, description="d, width of a bin; the paper gives no number [m]"
    )

    highest: bool = Field(
        True,
        description="whether the height of each bin's highest point stands in the observation, "
        "too, which shows obstacles thinner than a bin; false: the paper's observation [-]",
    )

    sides: bool = Field(
        False,
        description="whether the heights below the left and below the right tracks and the roll "
        "stand in the observation, too; in the side plane both sides are equal [-]",
    )

    flippers: Flippers = Field(
        "pairs",
        description="as robot.flippers, which sets it; the flippers whose angles follow [-]",
    )

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the flippers whose angles stand in an observation."""
        return JOINTS[self.flippers]

    @property
    def heights(self) -> int:
        """Number of heights in an observation, N or 2 N, three times as many with sides [-]."""
        return observation.heights(self.bins, self.highest, self.sides)

    @property
    def size(self) -> int:
        """Length of an observation: ``heights`` + joints + 1, and 1 more with sides [-]."""
        return self.heights + len(observation.angles(self.sides, len(self.joints)))

    @property
    def words(self) -> str:
        """The layout in words that name its settings, for errors."""
        kind = "true" if self.highest else "false"
        text = f"bins={self.bins}, bin_width={self.bin_width:g} m, highest={kind}"
        text += ", sides=true" if self.sides else ""
        return text if self.flippers == "pairs" else f"{text}, flippers={self.flippers}"

    @property
    def reach(self) -> float:
        """Half the length of the perceived ground [m]."""
        return observation.reach(self.bins, self.bin_width)

    @property
    def scale(self) -> FloatArray:
        """Typical magnitude of each number, by which networks divide, (n,) in SI units."""
        return observation.scale(self.heights, self.size - self.heights)


class Command(NamedTuple):
    """What an operator commands until the next command.

    Operators are people, and policies that command more often than they decide.
    """

    front: float
    """Target angle of the front flippers in frame R [rad]."""
    rear: float
    """Target angle of the rear flippers in frame R [rad]."""
    belts: float = 1.0
    """Speed of the belts as a share of ``robot.track_speed``, from -1 to 1 [-]."""
    took_front: float = 1.0
    """1 if the operator commands the front flippers, 0 if a policy does that helps [-]."""
    took_rear: float = 1.0
    """The same of the rear flippers [-]."""
    flippers: tuple[float, ...] = ()
    """Target angles of four flippers, as in ``RobotState``; empty: both sides alike [rad]."""

    @property
    def numbers(self) -> tuple[float, ...]:
        """All fields in one row, as they are recorded, (5,), of four flippers (9,)."""
        return (*self[:5], *self.flippers)

    @classmethod
    def of(cls, numbers: Sequence[float]) -> Command:
        """Return the command that has these ``numbers``."""
        front, rear, belts, took_front, took_rear, *flippers = numbers
        return cls(front, rear, belts, took_front, took_rear, tuple(flippers))


@dataclass(frozen=True)
class Perception:
    """All that a policy may know when it decides: the sensed terrain points and angles.

    The configuration's ``perception`` sets their accuracy.
    """

    observation: NDArray[np.float32]
    """The observation in the order of ``layout``, (n,) in SI units."""
    points: FloatArray
    """Sensed and ``filled`` terrain points in frame L, x never decreasing, (P, 2) [m]."""
    pitch: float
    """Sensed pitch of the chassis, nose up positive [rad]."""
    front: float
    """Sensed angle of the front flippers in frame R, or their mean [rad]."""
    rear: float
    """Sensed angle of the rear flippers in frame R, or their mean [rad]."""
    # What a policy knows without sensing.
    robot: RobotGeometry
    layout: ObservationLayout
    rng: np.random.Generator
    """Generator for random policies, seeded by the episode."""
    recent: tuple[NDArray[np.float32], ...]
    """The newest observations of the episode, ``observation`` last, at most ``MAX_HISTORY``."""
    # What only some sensors tell.
    filled: NDArray[np.bool_] | None = None
    """(P,) whether a point fills unseen ground; None: every point was seen."""
    friction: float | None = None
    """Friction between track and ground, known in exact perception only; None: unknown [-]."""
    seen: NDArray[np.bool_] | None = None
    """(N,) whether any ground of a bin was ever seen; None: all of it."""
    position: FloatArray | None = None
    """(2,) x and z of the chassis centre by odometry, from an origin of its own [m]; None: the
    sensor has no odometry."""
    deviation: FloatArray | None = None
    """(N,) standard deviation of the error of each height in ``observation``, as the sensor judges
    it, infinite where nothing was seen [m]; None: it is not judged."""
    roll: float = 0.0
    """Sensed roll of the chassis, left side up positive; 0 where it is not sensed [rad]."""
    flippers: tuple[float, ...] = ()
    """Sensed angles of four flippers, as in ``RobotState``; empty: of pairs [rad]."""


@dataclass(frozen=True)
class Transition:
    """One decision, from which reward terms and measures are computed."""

    before: RobotState
    after: RobotState
    pitches: FloatArray
    """Pitch at each decision of the episode so far, from the start to ``after``, (T,) [rad]."""
    action: tuple[int, ...]
    """Turn of each joint, (J,), each in {-1, 0, 1}: of pairs front and rear, of four flippers in
    the order of ``RobotState.flippers``."""
    profile: Profile
    robot: RobotGeometry
    outcome: Outcome | None = field(default=None)
    """How the episode ended; None while it runs."""
    # Optional, with defaults for a first decision and for bare predictions.
    path: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    """Poses of the chassis from ``before`` to ``after``, (S + 1, 3): x [m], z [m], pitch [rad]."""
    previous_action: tuple[int, ...] = (0, 0)
    """Action of the previous decision; zeros at the first decision of an episode."""
    flippers: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    """Angle of each joint in frame R at each pose of ``path``, (S + 1, J) [rad]."""
    sample_period: float = 0.01
    """Time between two poses of ``path`` [s]."""
    # What measures may use besides.
    perception: Perception | None = None
    """What the policy perceived when it decided; None in predictions. Measures may use it."""
    flipper_work: float | None = None
    """Integral of the flippers' absolute power, torque × angular speed, over the decision [J].

    None in predictions, and in an engine that does not measure it. Measures may use it.
    """
    roll_variation: float | None = None
    """Sum of the absolute roll changes between poses ``sample_period`` apart [rad].

    None in predictions, and in an engine that does not measure it. Measures may use it.
    """
    commands: FloatArray | None = None
    """``numbers`` of each ``Command`` in the decision, (K, 5) or (K, 9).

    None: the policy chose an action.
    """

    @property
    def ended(self) -> bool:
        """Whether the decision ended the episode."""
        return self.outcome is not None

    @property
    def reached(self) -> bool:
        """Whether the decision reached the finish."""
        return self.outcome is Outcome.REACHED


@dataclass(frozen=True, eq=False)
class RecordedEpisode:
    """An episode of T decisions with the observations of its policy."""

    number: int
    """Number of the episode in its run or evaluation, from 0."""
    seed: int
    terrain: str
    """Label of the sampled profile."""
    outcome: Outcome
    observations: NDArray[np.float32]
    """Observations of single instants, (T + 1, n) in SI units."""
    actions: NDArray[np.int64]
    """Indices of the actions taken, (T,)."""
    rewards: NDArray[np.float64]
    """Sums of the weighted reward terms, (T,) [-]; see ``TrainingEpisodes`` for others."""
    labels: NDArray[np.float32]
    """Target distributions over actions for a student, (T, 3^J); zeros without a label."""
    commands: FloatArray | None = None
    """``numbers`` of an operator's commands, (K, 5) or (K, 9); None of a policy that chooses
    actions."""
