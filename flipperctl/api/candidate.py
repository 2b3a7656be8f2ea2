"""The flipper angle that clears the terrain, from the paper's R_flipper and the rule ``okada``."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flipperctl.api.values import RobotGeometry
from flipperctl.core.arrays import FloatArray


def candidate_angle(
    points: FloatArray,
    pitch: float,
    robot: RobotGeometry,
    *,
    near: float = 0.1,
    far: float = 0.45,
    rear: bool = False,
) -> float:
    """Return the flipper angle that just clears the terrain ahead (behind for ``rear``) [rad].

    It is the largest angle in frame R of the vectors from the hinge to the terrain points inflated
    by the track radius: atan2(z, u) + asin(r / distance) (paper Sec. III-D, Okada et al. 2011).
    ``points`` are (P, 2) in frame L [m]; only those between ``near`` and ``far`` [m] from the
    hinge, measured along the chassis, count, since a point under the hinge would outweigh all
    others. The angle is clipped to the range of the flippers; without points it is 0.
    """
    x, z = points.T
    return float(candidate_angles(x, z, pitch, robot, near=near, far=far, rear=rear))


def candidate_angles(
    x: FloatArray,
    z: FloatArray,
    pitch: Any,
    robot: RobotGeometry,
    *,
    near: float = 0.1,
    far: float = 0.45,
    rear: bool = False,
) -> Any:
    """Return ``candidate_angle`` of M poses of these pitches (M,) [rad], (M,) [rad].

    ``x`` and ``z`` are the points of each pose in its frame L, (M, P) [m]; NaN stands for no point.
    Of a single pose, ``pitch`` is a float, the points are (P,), and the angle is a float.
    """
    one = isinstance(pitch, float)
    # numpy's cosine may differ in the last bit, which would decide whether a point counts.
    turns = [(math.cos(a), math.sin(a)) for a in ((pitch,) if one else pitch.tolist())]
    cos, sin = turns[0] if one else np.array(turns).reshape(-1, 2).T[:, :, None]
    along, up = cos * x + sin * z, cos * z - sin * x
    u = (-along if rear else along) - robot.hinge_offset
    chosen = (u >= near) & (u <= far)
    u, up = u[chosen], up[chosen]
    angles = np.arctan2(up, u) + np.arcsin(np.minimum(1.0, robot.track_radius / np.hypot(u, up)))
    if one:
        return robot.clip(float(np.maximum.reduce(angles))) if angles.size else 0.0
    largest = np.full(len(x), -math.inf)
    np.maximum.at(largest, chosen.nonzero()[0], angles)
    clipped = np.clip(largest, -robot.angle_limit, robot.angle_limit)
    return np.where(largest == -math.inf, 0.0, clipped)
