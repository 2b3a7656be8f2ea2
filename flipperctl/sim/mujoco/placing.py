"""Where a robot is placed in 3-D, whose ground and heading the profile does not know.

In: the pose at which a straight robot would rest on the profile. Out: a pose that overlaps nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from flipperctl.api import FloatArray, Profile, Robot, Start
from flipperctl.sim.mujoco.ground import ROUGH_MARGIN
from flipperctl.sim.mujoco.settings import MujocoSettings
from flipperctl.sim.resting import OVERLAP


def farther(profile: Profile, robot: Robot, sim: MujocoSettings, start: Start, yaw: float) -> float:
    """Return how much farther ahead a level robot may overlap than a straight one on the profile.

    By the corner of a turned robot, and by what reaches onto rough ground before the first edge
    [m].
    """
    corner = (sim.flipper_offset + sim.track_width / 2) * abs(math.sin(yaw))
    if not sim.roughness:
        return corner
    tip = robot.hinge_offset + robot.flipper_axle * math.cos(start.front) + robot.track_radius
    return corner + max(0.0, start.x + corner + tip - (profile.start - ROUGH_MARGIN))


def clear(pose: FloatArray, start: Start, most: float, penetration: Callable[[], float]) -> None:
    """Move the robot off what it overlaps where a straight one on the profile would not.

    Past the first edge it goes up, off rough patches and turned edges; ahead of it, back, by
    ``most`` or less [m], see ``farther``. ``pose``: changed, it begins with x, y and z of the
    chassis [m]; ``penetration`` returns the depth of the overlap at the pose of now [m].
    """
    if start.height is not None:
        while (depth := penetration()) > OVERLAP:
            pose[2] += depth
        return
    nearest = start.x - most
    while (depth := penetration()) > OVERLAP and pose[0] > nearest:
        pose[0] = max(nearest, pose[0] - depth)
