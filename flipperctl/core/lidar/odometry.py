"""Odometry from belt speeds and an inertial unit.

In: messages with their times. Out: the pose in frame M, in which the robot starts at the origin
with the heading 0. Belts that slip make the robot seem faster than it is.
"""

from __future__ import annotations

from dataclasses import replace

from flipperctl.core.arrays import FloatArray
from flipperctl.core.lidar.messages import Inertial, Pose
from flipperctl.core.lidar.rotations import heading

_LONGEST = 0.5
"""Longest pause between two messages over which a motion is integrated [s]."""


def advanced(pose: Pose, inertial: Inertial, speed: float, elapsed: float) -> Pose:
    """Return the pose after the robot has moved along its chassis for ``elapsed`` [s].

    ``speed``: speed of the belts [m/s]. After a pause in the messages the motion is unknown, and
    only ``_LONGEST`` of it is integrated.
    """
    elapsed = min(max(elapsed, 0.0), _LONGEST)
    yaw = pose.yaw + inertial.yaw_rate * elapsed
    x, y, z = (speed * elapsed * heading(inertial.pitch, yaw)).tolist()
    return Pose(pose.x + x, pose.y + y, pose.z + z, inertial.roll, inertial.pitch, yaw)


def moved_to(pose: Pose, position: FloatArray) -> Pose:
    """Return the pose at another ``position``, (3,) [m]."""
    x, y, z = position.tolist()
    return replace(pose, x=x, y=y, z=z)
