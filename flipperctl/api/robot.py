"""The robot, with masses, speeds and torques, and the flipper angle that clears the terrain."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api.values import RobotGeometry
from flipperctl.core import FloatArray
from flipperctl.core.targets import JOINTS, Flippers


class Robot(RobotGeometry):
    """Geometry from the paper, and masses from the laboratory's public robot model."""

    # What ``randomise`` may sample, and how.
    not_sampled: ClassVar[frozenset[str]] = frozenset(
        {"angle_limit", "angle_step", "control_period", "flippers"}
    )
    added: ClassVar[frozenset[str]] = frozenset({"flippers"})
    flippers: Flippers = Field(
        "pairs",
        description="pairs: the left and the right flippers turn together, as in the paper; four: "
        "each turns alone, in 3-D [-]",
    )
    factors: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "size": ("chassis_length", "flipper_length", "track_radius")
    }
    null_values: ClassVar[Mapping[str, float]] = {
        "track_force": math.inf,
        **dict.fromkeys(("payload", "payload_x", "payload_z"), 0.0),
    }
    # Masses.
    chassis_mass: float = Field(35.0, gt=1, le=500, description="chassis with main tracks [kg]")
    flipper_mass: float = Field(5.0, gt=0.1, le=100, description="one pair of flippers [kg]")
    # Motors.
    track_speed: float = Field(
        0.2, gt=0, le=2, description="speed of all belts' surfaces along their outline [m/s]"
    )
    flipper_speed: float = Field(
        math.radians(25), gt=0.05, le=5, description="turning rate of a flipper pair [rad/s]"
    )
    flipper_torque: float = Field(
        200.0,
        gt=1,
        le=5000,
        description="largest torque of a flipper pair; not given in the paper [N m]",
    )
    actuator_delay: float = Field(
        0.0,
        ge=0,
        le=0.5,
        description="delay of the flippers' turn after a decision; not given in the paper [s]",
    )

    track_force: float | None = Field(
        None,
        gt=1,
        le=50_000,
        description="largest force of all belts together along the ground, the torque limit of the "
        "tracks' motors over the sprockets' radius; null: friction alone limits it [N]",
    )
    # A load, as a point on the chassis.
    payload: float | None = Field(
        None, ge=0, le=500, description="mass of a load on the chassis; null: none [kg]"
    )
    payload_x: float | None = Field(
        None,
        ge=-2,
        le=2,
        description="distance of the load's centre ahead of the chassis centre; null: 0 [m]",
    )
    payload_z: float | None = Field(
        None,
        ge=-2,
        le=2,
        description="height of the load's centre above the chassis centre; null: 0 [m]",
    )
    # Decisions.
    control_period: float | None = Field(
        None,
        gt=0,
        le=10,
        description="time between two decisions; null is angle_step / flipper_speed, in which a "
        "flipper turns by one step [s]",
    )

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints of the flippers, those at the front first, left before right."""
        return JOINTS[self.flippers]

    @property
    def carried_mass(self) -> float:
        """Mass of the chassis with its load [kg]."""
        return self.chassis_mass + (self.payload or 0.0)

    @property
    def mass(self) -> float:
        """Mass of the whole robot with its load [kg]."""
        return self.carried_mass + 2 * self.flipper_mass

    @property
    def centre_of_mass(self) -> tuple[float, float]:
        """Centre of mass of the chassis with its load, (x, z) in frame R [m]."""
        share = (self.payload or 0.0) / self.carried_mass
        return share * (self.payload_x or 0.0), share * (self.payload_z or 0.0)

    @property
    def load_inertia(self) -> tuple[float, float]:
        """What the load adds to the chassis' moment of inertia about the common centre of mass.

        Twice [kg m²]: of the distance along the chassis, and of the height. The load is a point, so
        that both masses turn about that centre: μ · distance² with μ = m · M / (m + M).
        """
        reduced = self.chassis_mass * (self.payload or 0.0) / self.carried_mass
        return reduced * (self.payload_x or 0.0) ** 2, reduced * (self.payload_z or 0.0) ** 2

    @property
    def decision_period(self) -> float:
        """Time between two decisions [s]."""
        if self.control_period is not None:
            return self.control_period
        return self.angle_step / self.flipper_speed


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

    It is the largest angle in frame R from the hinge to the terrain points, inflated by the track
    radius: atan2(z, u) + asin(r / distance) (paper Sec. III-D, Okada et al. 2011). ``points`` are
    (P, 2) in frame L [m]. Only points between ``near`` and ``far`` [m] from the hinge count,
    measured along the chassis: a point under the hinge would outweigh all others. The angle is
    clipped to the range of the flippers; without points it is 0.
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
    is_number = isinstance(pitch, float)
    # numpy's cosine may differ in the last bit, which would decide whether a point counts.
    turns = [(math.cos(a), math.sin(a)) for a in ((pitch,) if is_number else pitch.tolist())]
    cos, sin = turns[0] if is_number else np.array(turns).reshape(-1, 2).T[:, :, None]
    # From frame L to R: along the chassis and above it.
    along, up = cos * x + sin * z, cos * z - sin * x
    u = (-along if rear else along) - robot.hinge_offset
    within = (u >= near) & (u <= far)
    u, up = u[within], up[within]
    # A point closer than the track's radius counts as one at that distance.
    angles = np.arctan2(up, u) + np.arcsin(np.minimum(1.0, robot.track_radius / np.hypot(u, up)))
    if is_number:
        return robot.clip(float(np.maximum.reduce(angles))) if angles.size else 0.0
    # The largest angle of each pose; -inf marks a pose without points.
    largest = np.full(len(x), -math.inf)
    np.maximum.at(largest, within.nonzero()[0], angles)
    clipped = np.clip(largest, -robot.angle_limit, robot.angle_limit)
    return np.where(largest == -math.inf, 0.0, clipped)
