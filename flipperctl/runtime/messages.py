"""What a robot's builder and its driver hand to ``FlipperController``: the setup and messages.

In: numbers in the robot's convention; ``JointState`` messages, which may hold a part of the joints
each. Out: frozen settings, checked; plain data with the time of the measurement, whose content
``intake`` checks; the mean angle of each pair of flippers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from flipperctl.core.lidar.body import Mount
from flipperctl.errors import PolicyError


@dataclass(frozen=True)
class Signs:
    """1 where the robot's convention agrees with flipperctl's, -1 where it is opposite."""

    front: int = 1
    """Of the front flippers' angle: flipperctl's grows when they are raised."""
    rear: int = 1
    """Of the rear flippers' angle: flipperctl's grows when they are raised."""
    pitch: int = 1
    """Of the pitch: flipperctl's grows when the nose is lifted."""
    yaw: int = 1
    """Of the yaw rate: flipperctl's is positive to the left."""
    x: int = 1
    """Of the x axis of clouds and odometry: flipperctl's points ahead. -1 turns clouds by π."""

    def __post_init__(self) -> None:
        """Refuse other factors."""
        for sign in fields(self):
            value = getattr(self, sign.name)
            if value not in (1, -1) or isinstance(value, bool):
                raise PolicyError(f"signs.{sign.name} is {value!r}; 1 or -1 is allowed")


OURS = Signs()
"""The robot measures as flipperctl does."""
REP_103 = Signs(front=-1, pitch=-1)
"""Rotations about +y, to the left: front flipper down, rear flipper up and nose down positive."""
CONVENTIONS = {"flipperctl": OURS, "rep103": REP_103}
"""The named conventions."""


@dataclass(frozen=True)
class RobotSetup:
    """What the policy's file does not state of the robot: its devices, widths and signs."""

    signs: Signs = OURS
    """The robot's conventions."""
    cloud_frame: str = "lidar"
    """Frame in which clouds must come."""
    attitude_frame: str = "base_link"
    """Frame whose attitude must come: fixed to the chassis, x ahead, y to the left, z up."""
    mount: Mount = field(default_factory=lambda: Mount(0.25, 0.4, -math.pi / 4, 0.1, 0.05))
    """Where the frame of the clouds is on the robot.

    Clouds that come in the frame of the chassis have the mount ``Mount(0, 0, math.pi / 2, …)``.
    """
    chassis_width: float = 0.352
    """Width of the chassis between the flippers [m]."""
    overall_width: float = 0.712
    """Width over the outer sides of the flippers [m]."""
    pose: Literal["belts", "matched"] = "belts"
    """How scans enter the map: by odometry, or corrected by matching (needs small_gicp)."""
    range_bias: float = 0.02
    """Largest constant error of the LiDAR's distances [m]."""
    tilt_error: float = 0.0031622776601683794
    """Standard deviation of the inertial unit's roll and pitch [rad]."""


@dataclass(frozen=True)
class Ages:
    """Oldest measurements that a decision may use [s]."""

    cloud: float = 0.5
    """A LiDAR at 10 Hz may lose four scans."""
    attitude: float = 0.1
    """An inertial unit at 100 Hz may lose ten."""
    joints: float = 0.1
    """Encoders at 50 Hz may lose five."""
    odometry: float = 0.3
    """Belt speeds; they count only if they were ever received."""


@dataclass(frozen=True)
class Limits:
    """What the controller takes for safe."""

    ages: Ages = field(default_factory=Ages)
    """Oldest measurements."""
    ahead: float = 0.05
    """Time by which a stamp may lie ahead of the clock [s]."""
    clock_jump: float = 1.0
    """Pause between two steps that counts as a jump of the clock [s]."""
    coverage: float = 0.3
    """Least share of the bins in which ground was seen or stood on [-]."""
    tilt: float = math.radians(55)
    """Largest roll or pitch, both ways; beyond it the belts stop at once [rad]."""
    stop_after: float = 1.0
    """Time for which flippers are held before the belts stop too [s]."""
    short_gap: float = 0.3
    """Time without messages after which the policy goes on where it was, and its targets [s]."""
    recurs: float = 0.6
    """Time without a fault before another one counts as another, not as one that lasts [s]."""
    rest: float = 2.0
    """Time without a fault after which a robot that stopped for a gap goes on by itself [s]."""
    again: float = 10.0
    """Time in which a second stop, or a second stall, stops until it is acknowledged [s]."""
    valid_for: float = 0.3
    """Time for which a command counts, see ``Answer`` [s]."""
    standby_speed: float = 0.02
    """Speed of the belts ahead below which the flippers stand by [m/s]."""
    standby_after: float = 0.5
    """Time of such a speed after which they do; one at the start counts at once [s]."""
    standby_until: float = 0.3
    """Time of a larger speed after which the flippers stand by no longer [s]."""
    stall_error: float = 0.12
    """Angle by which a flipper may be off its commands for longer than ``stall_time`` [rad]."""
    stall_time: float = 2.0
    """Time of being off its commands after which a flipper counts as stalled [s]."""
    stall_hold: float = 1.0
    """Time for which a stalled flipper is held where it is [s]."""

    def __post_init__(self) -> None:
        """Refuse numbers that are not positive and finite."""
        for name, value in (vars(self) | vars(self.ages) | {"ages": 1.0}).items():
            if not (isinstance(value, int | float) and 0 < value < math.inf):
                raise PolicyError(
                    f"limits: {name} is {value!r}; a finite number above 0 is allowed"
                )


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of a LiDAR or a depth camera."""

    time: float
    """Instant at which the points were measured, by the clock of ``step`` [s].

    Of a turning LiDAR, the end of the turn, if ``ages`` are given.
    """
    frame: str
    """Name of the frame of the points."""
    points: ArrayLike
    """(P, 3) points [m]; rows that are not finite are left out."""
    ages: ArrayLike | None = None
    """(P,) how long before ``time`` each point was measured [s], by which the robot's motion is
    taken out; None: all at ``time``, or moved there by the driver."""


@dataclass(frozen=True)
class Attitude:
    """What an inertial unit says of the chassis."""

    time: float
    """Instant of the measurement [s]."""
    frame: str
    """Name of the frame whose attitude it is."""
    roll: float
    """Angle of the y axis, to the left, above the horizontal [rad]."""
    pitch: float
    """Angle of the x axis, ahead, above the horizontal [rad], before the sign of ``Signs``."""
    yaw_rate: float
    """Turn of the heading, to the left positive [rad/s]."""
    tilt_rates: tuple[float, float] = (0.0, 0.0)
    """Rates about the x and y axes, with which the change of the angles is compared [rad/s]."""
    acceleration: tuple[float, float, float] | None = None
    """Acceleration along the axes x, y and z, gravity included, with which they are compared as
    well [m/s²]."""

    @classmethod
    def from_quaternion(
        cls, time: float, frame: str, x: float, y: float, z: float, w: float, yaw_rate: float
    ) -> Attitude:
        """Return the attitude of a quaternion from the frame to a level world with z up.

        The pitch is positive nose **down**, as rotations about +y are (REP 103). A quaternion whose
        length is not 1, as of a unit that tells no orientation, gives NaN, which is refused.
        """
        if not abs(math.hypot(x, y, z, w) - 1) < _UNIT:
            return cls(time, frame, math.nan, math.nan, yaw_rate)
        rises_x, rises_y = 2 * (x * z - w * y), 2 * (y * z + w * x)
        return cls(time, frame, _asin(rises_y), -_asin(rises_x), yaw_rate)

    @classmethod
    def from_imu(
        cls,
        time: float,
        frame: str,
        orientation: tuple[float, float, float, float],
        rates: tuple[float, float, float],
        acceleration: tuple[float, float, float] | None = None,
    ) -> Attitude:
        """Return the attitude of an ``Imu`` of ROS.

        ``orientation``: x, y, z and w, as of ``from_quaternion``; ``rates``: of the frame about its
        own axes [rad/s]; ``acceleration``: along these, None if it has none [m/s²]. When the robot
        leans, the rate about its z axis is not the yaw rate; this corrects it.
        """
        x, y, z, w = orientation
        # The rate about the vertical, by how far each axis rises
        rises = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)  # of the axes
        level = max(1 - rises[0] ** 2, _STEEPEST)
        turn = (rises[1] * rates[1] + rises[2] * rates[2]) / level
        attitude = cls.from_quaternion(time, frame, x, y, z, w, turn)
        return replace(attitude, tilt_rates=(rates[0], rates[1]), acceleration=acceleration)


@dataclass(frozen=True)
class JointAngles:
    """The measured angles of the flippers."""

    time: float
    """Instant of the measurement [s]."""
    front: float
    """Angle of the front flippers, before the sign of ``Signs`` [rad]."""
    rear: float
    """Angle of the rear flippers, before the sign of ``Signs`` [rad]."""
    offsets: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    """What the joints of the front and of the rear pair, left and right, are measured off the above
    [rad]: each joint is then compared with what was commanded. None: they are not known."""


@dataclass(frozen=True)
class Odometry:
    """The speed of the belts from their encoders, not that of the robot over the ground.

    It tells belts that stand from belts that slip: while they do not drive ahead, the controller
    decides nothing.
    """

    time: float
    """Instant of the measurement [s]."""
    speed: float
    """Mean of the left and the right belts, forward positive, before ``Signs`` [m/s]."""


KINDS: dict[str, type[Any]] = {
    "joints": JointAngles,
    "attitude": Attitude,
    "odometry": Odometry,
    "cloud": Cloud,
}
"""The messages by their device."""
_STEEPEST = 1e-3
"""Smallest square of the cosine of the pitch with which a heading is told [-]."""
_UNIT = 0.05
"""Most by which the length of a quaternion may differ from 1 [-]."""


def _asin(value: float) -> float:
    return math.asin(min(1.0, max(-1.0, value))) if math.isfinite(value) else math.nan


class NewestJoints:
    """The newest angle of each flipper's joint."""

    def __init__(self, front: Sequence[str], rear: Sequence[str], scale: float = 1.0) -> None:
        """``front`` and ``rear``: names of the joints of each pair.

        A - before a name tells that the joint counts the other way. ``scale``: angle of 1 [rad].
        """
        names = *front, *rear
        self._signs = {n.lstrip("-"): -scale if n.startswith("-") else scale for n in names}
        self._pairs = [[name.lstrip("-") for name in pair] for pair in (front, rear)]
        self._angles: dict[str, tuple[float, float]] = {}  # joint → its stamp and angle

    @property
    def missing(self) -> list[str]:
        """The joints without an angle yet."""
        return [name for name in self._signs if name not in self._angles]

    def take(
        self, stamp: float, names: Iterable[str], positions: Iterable[float]
    ) -> JointAngles | None:
        """Receive a message; return the angles of the pairs, of the stamp of the oldest of them.

        None: the message is of other joints, or there is a joint without an angle yet.
        """
        pairs = zip(names, positions, strict=False)
        newest = {n: (stamp, self._signs[n] * float(p)) for n, p in pairs if n in self._signs}
        self._angles |= newest
        if not newest or self._signs.keys() - self._angles.keys():
            return None
        oldest = float(np.min([time for time, _ in self._angles.values()]))  # NaN if one is
        angles = [tuple(self._angles[n][1] for n in pair) for pair in self._pairs]
        front, rear = (math.fsum(pair) / len(pair) for pair in angles)
        off = [tuple(a - m for a in p) for p, m in zip(angles, (front, rear), strict=True)]
        return JointAngles(oldest, front, rear, (off[0], off[1]))


ABSENT = "a filter such as imu_filter_madgwick adds an orientation"
