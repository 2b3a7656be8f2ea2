"""Where a robot is placed in 3-D, whose ground and heading the profile does not know.

In: the pose at which a straight robot would rest on the profile. Out: a pose that overlaps nothing.
"""

from __future__ import annotations

from collections.abc import Callable

from flipperctl.api import FloatArray, Start
from flipperctl.sim.resting import OVERLAP


def clear(pose: FloatArray, start: Start, corner: float, penetration: Callable[[], float]) -> None:
    """Move the robot off what it overlaps where a straight one on the profile would not.

    Past the first edge it goes up, off rough patches and turned edges; ahead of it, back, by at
    most what a turned robot's corner reaches farther ahead, ``corner`` [m]. ``pose``: changed, it
    begins with x, y and z of the chassis [m]; ``penetration`` returns the depth of the overlap at
    the pose of now [m].
    """
    if start.height is not None:
        while (depth := penetration()) > OVERLAP:
            pose[2] += depth
        return
    nearest = start.x - corner
    while (depth := penetration()) > OVERLAP and pose[0] > nearest:
        pose[0] = max(nearest, pose[0] - depth)
