"""The flipper angle that clears the terrain, from the paper's R_flipper and the rule ``okada``."""

from __future__ import annotations

import math

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
    cos, sin = math.cos(pitch), math.sin(pitch)
    along = cos * points[:, 0] + sin * points[:, 1]
    up = cos * points[:, 1] - sin * points[:, 0]
    u = (-along if rear else along) - robot.hinge_offset
    chosen = (u >= near) & (u <= far)
    u, up = u[chosen], up[chosen]
    if not u.size:
        return 0.0
    inflation = np.arcsin(np.minimum(1.0, robot.track_radius / np.hypot(u, up)))
    return robot.clip(float(np.maximum.reduce(np.arctan2(up, u) + inflation)))


def candidate_angles(
    x: FloatArray,
    z: FloatArray,
    pitch: FloatArray,
    robot: RobotGeometry,
    *,
    near: float = 0.1,
    far: float = 0.45,
    rear: bool = False,
) -> FloatArray:
    """Return ``candidate_angle`` of M poses of these pitches (M,) [rad], (M,) [rad].

    ``x`` and ``z`` are the points of each pose in its frame L, (M, P) [m]; NaN stands for no point.
    """
    # numpy's cosine may differ in the last bit, which would decide whether a point counts.
    listed = pitch.tolist()
    cos, sin = np.array([[math.cos(a) for a in listed], [math.sin(a) for a in listed]])
    along = cos[:, None] * x + sin[:, None] * z
    u = (-along if rear else along) - robot.hinge_offset
    chosen = np.flatnonzero((u >= near) & (u <= far))
    row = chosen // max(1, x.shape[1])
    u, up = u.take(chosen), cos[row] * z.take(chosen) - sin[row] * x.take(chosen)
    inflation = np.arcsin(np.minimum(1.0, robot.track_radius / np.hypot(u, up)))
    largest = np.full(len(pitch), -math.inf)
    np.maximum.at(largest, row, np.arctan2(up, u) + inflation)
    clipped = np.clip(largest, -robot.angle_limit, robot.angle_limit)
    return np.where(largest == -math.inf, 0.0, clipped)
