"""Messages of the devices on the robot.

In: what a driver or a simulated instrument has measured. Out: plain data for the estimator.
"""

from __future__ import annotations

from dataclasses import dataclass

from flipperctl.core.arrays import FloatArray


@dataclass(frozen=True)
class Scan:
    """A turn of the LiDAR."""

    points: FloatArray
    """(P, 3) points that returned, in frame S at the time of each [m]; one that is not finite is
    ignored."""
    ages: FloatArray | None = None
    """(P,) time from the measurement of each point to that of the message [s]; None: all points
    were measured at the same instant."""


@dataclass(frozen=True)
class Joints:
    """The angles of the flippers from their encoders."""

    front: float
    """Angle of the front flippers in frame R [rad]."""
    rear: float
    """Angle of the rear flippers in frame R [rad]."""


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

    It is that of the chassis centre, in frame R, as an average since the message before.
    """

    x: float
    """Along the chassis, forward positive [m/s²]."""
    y: float
    """Across the chassis, to the left positive [m/s²]."""
    z: float
    """Perpendicular to both, upwards of the chassis positive [m/s²]."""
