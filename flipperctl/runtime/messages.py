"""The messages that a robot's driver hands to ``FlipperController.step``.

In: numbers of the driver. Out: plain data with the time of the measurement. Nothing is checked
here: the controller refuses what does not fit, with a reason.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from numpy.typing import ArrayLike


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
    """Rates about the x and y axes, by which an orientation that no one fills in is noticed
    [rad/s]."""

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
    ) -> Attitude:
        """Return the attitude of an ``Imu`` of ROS.

        ``orientation``: x, y, z and w, as of ``from_quaternion``; ``rates``: of the frame about its
        own axes [rad/s]. A robot that pitches while it leans turns about its z axis, too, which is
        no turn of its heading.
        """
        x, y, z, w = orientation
        rises = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)  # of the axes
        level = max(1 - rises[0] ** 2, _STEEPEST)
        turn = (rises[1] * rates[1] + rises[2] * rates[2]) / level
        found = cls.from_quaternion(time, frame, x, y, z, w, turn)
        return replace(found, tilt_rates=(rates[0], rates[1]))


@dataclass(frozen=True)
class JointAngles:
    """The measured angles of the flippers."""

    time: float
    """Instant of the measurement [s]."""
    front: float
    """Angle of the front flippers, before the sign of ``Signs`` [rad]."""
    rear: float
    """Angle of the rear flippers, before the sign of ``Signs`` [rad]."""


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


_STEEPEST = 1e-3
"""Smallest square of the cosine of the pitch with which a heading is told [-]."""
_UNIT = 0.05
"""Most by which the length of a quaternion may differ from 1 [-]."""


def _asin(value: float) -> float:
    return math.asin(min(1.0, max(-1.0, value))) if math.isfinite(value) else math.nan
