"""Messages of the devices on the robot, and their checks before the estimator uses them.

In: what a driver or a simulated instrument has measured. Out: plain data for the estimator, without
numbers that cannot be; nothing if none is left; or ``PerceptionError`` if it is malformed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import FloatArray


@dataclass(frozen=True)
class Scan:
    """A turn of the LiDAR."""

    points: FloatArray
    """(P, 3) points that returned, in frame S at the time of each [m]; one that is not finite is
    ignored."""
    ages: FloatArray | None = None
    """(P,) time from the measurement of each point to the message's time [s]; None: all points
    were measured at the same instant."""

    def take(self, rows: NDArray[np.int64]) -> Scan:
        """Return the scan with some of its points."""
        ages = None if self.ages is None else self.ages.take(rows)
        return Scan(self.points.take(rows, axis=0), ages)


@dataclass(frozen=True)
class Joints:
    """The angles of the flippers from their encoders."""

    front: float
    """Angle of the front flippers in frame R [rad]."""
    rear: float
    """Angle of the rear flippers in frame R [rad]."""
    flippers: tuple[float, ...] = ()
    """Angles of four flippers, of which these are means, as in ``SensedAngles``; empty: of pairs
    [rad]."""


@dataclass(frozen=True)
class Pose:
    """A pose in the map's frame M from outside the estimator, such as a tracking system."""

    x: float
    """Position of the chassis centre ahead [m]."""
    y: float
    """Position of the chassis centre to the left [m]."""
    z: float
    """Height of the chassis centre [m]."""
    roll: float
    """Angle of the chassis' y axis above the horizontal [rad]."""
    pitch: float
    """Angle of the chassis' x axis above the horizontal [rad]."""
    yaw: float
    """Heading from the x axis of frame M, to the left positive [rad]."""


@dataclass(frozen=True)
class Inertial:
    """The attitude that an inertial unit computes, and the rate of its heading."""

    roll: float
    """Angle of the chassis' y axis above the horizontal [rad]."""
    pitch: float
    """Angle of the chassis' x axis above the horizontal [rad]."""
    yaw_rate: float
    """Turn of the heading, to the left positive [rad/s]."""


@dataclass(frozen=True)
class Belts:
    """The speed of the belts from their encoders."""

    speed: float
    """Mean speed of the belts' surfaces on the left and the right, forward positive [m/s]."""
    difference: float = 0.0
    """By how much the right belts are faster than the left ones [m/s]."""


@dataclass(frozen=True)
class SpecificForce:
    """What an accelerometer measures: acceleration less gravity, so that 9.81 m/s² is at rest.

    It acts on the chassis centre, in frame R, and is an average since the message before.
    """

    x: float
    """Along the chassis, forward positive [m/s²]."""
    y: float
    """Across the chassis, to the left positive [m/s²]."""
    z: float
    """Perpendicular to both, upwards of the chassis positive [m/s²]."""


_LARGEST = {"x": 1e5, "y": 1e5, "z": 1e5, "speed": 10.0, "yaw_rate": 100.0}
"""Largest position [m], speed [m/s] and rate [rad/s] that a robot can have."""
_LARGEST_ANGLE = 1e4  # largest angle; headings may count turns [rad]
_LIMITS: Mapping[type[Pose | Joints | Inertial | Belts], Mapping[str, float]] = {
    kind: {
        field.name: _LARGEST.get(field.name, _LARGEST_ANGLE)
        for field in fields(kind)
        if field.type == "float"  # the others are checked apart
    }
    for kind in (Inertial, Belts, Joints, Pose)
}
"""The largest number of each field of a message, by its class."""
_LARGEST_TIME = 1e12  # largest time, in either direction; clocks may count from 1970 [s]
_FARTHEST = 1e3  # farthest point of a scan [m]


class PerceptionError(ValueError):
    """A message is malformed, or nothing can be estimated; the text says why.

    The estimator raises no other exception because of its input, and is as it was before.
    """


def checked(
    time: object, value: object
) -> tuple[float, Pose | Joints | Inertial | Belts | Scan] | None:
    """Return time [s] and message; None if it holds no such numbers or is of another kind.

    Points that are not finite or farther than a LiDAR sees are dropped.

    Raises:
        PerceptionError: a number is no number, or an array has another shape or type.
    """
    if not isinstance(value, Scan | Pose | Joints | Inertial | Belts):
        return None
    # Number by number, with its name in the error
    at = number(time, "the time of a message")
    if not abs(at) <= _LARGEST_TIME:  # nor NaN
        return None
    if isinstance(value, Scan):
        return at, checked_scan(value)
    kind, limits = next(entry for entry in _LIMITS.items() if isinstance(value, entry[0]))
    numbers: dict[str, Any] = {name: number(getattr(value, name), name) for name in limits}
    within = all(abs(numbers[name]) <= most for name, most in limits.items())
    flippers = tuple(number(angle, "an angle") for angle in getattr(value, "flippers", ()))
    within &= all(abs(angle) <= _LARGEST_ANGLE for angle in flippers)
    numbers |= {"flippers": flippers} if flippers else {}
    return (at, kind(**numbers)) if within else None


def real(value: object) -> float | None:
    """Return a real number of Python or numpy as a float, also if not finite; else None."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf


def number(value: object, name: str) -> float:
    """Return ``value`` as a float, which may be infinite or NaN; else raise an error."""
    if (result := real(value)) is None:
        raise PerceptionError(f"{name} is {_kind(value)}; a number is needed")
    return result


def short(value: object) -> str:
    """Return a value as text of at most 40 characters."""
    try:
        return str(value)[:40]
    except ValueError:  # Python writes no integer of more than 4300 digits
        return type(value).__name__


def checked_scan(scan: Scan) -> Scan:
    """Return the scan with possible points alone, each with what is measured about it.

    Raises:
        PerceptionError: an array has another shape or type.
    """
    # A wrong shape or type is malformed; an impossible point is only left out.
    points = _array(scan.points, "points")
    if points.ndim != 2 or points.shape[1] != 3:
        raise PerceptionError(f"points have the shape {points.shape}; (P, 3) is needed")
    ages = None if scan.ages is None else _array(scan.ages, "ages")
    if ages is not None and ages.shape != (len(points),):
        text = f"ages has the shape {ages.shape}; {(len(points),)} is needed"
        raise PerceptionError(text)
    with np.errstate(invalid="ignore"):
        possible = np.abs(points) <= _FARTHEST  # False for NaN
    usable = possible.all(axis=1)
    if ages is not None:
        usable &= np.isfinite(ages)
    result = Scan(points, ages)
    return result if usable.all() else result.take(np.flatnonzero(usable))


def without_near(scan: Scan, near: float) -> Scan:
    """Return the scan without points nearer than ``near`` [m], as zeros for rays without return."""
    far = np.einsum("ij,ij->i", scan.points, scan.points) >= near**2
    return scan if far.all() else scan.take(np.flatnonzero(far))


def thinned(scan: Scan, most: int) -> Scan:
    """Return the scan with at most so many points, which are evenly distributed over it."""
    count = len(scan.points)
    # no fixed stride, which would leave out whole rings
    return scan if count <= most else scan.take(np.arange(most) * count // most)


def _array(value: object, name: str) -> FloatArray:
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
        with np.errstate(over="ignore"):
            return value.astype(np.float64, copy=False)
    raise PerceptionError(f"{name} is {_kind(value)}; an array of numbers is needed")


def _kind(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype}"
    return f"of the type {type(value).__name__}"
