"""Reward terms of the robot's contact with the ground: stability, support and clearance."""

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import FloatArray, RewardTerm, Transitions, reward

from ..posture import centre_of_mass, contacts, load_offset, load_share


@reward("stability")
class Stability(RewardTerm):
    """Penalise a small static stability margin; the reward is -1 without a margin.

    The margin is the horizontal distance of the centre of mass from the nearer end of the support.
    The support reaches from the rearmost to the foremost point at which the robot touches the
    ground (McGhee and Frank 1968, in the side plane). The robot's outline is three capsules:
    chassis and flipper pairs. Without a margin the robot tips over its last contact or is in the
    air. The centre of mass includes the load.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    enough: float = Field(0.2, gt=0, le=2, description="smallest margin without a penalty [m]")
    touch: float = Field(
        0.01, gt=0, le=0.1, description="largest gap to the ground that counts as contact [m]"
    )
    flipper_share: float = Field(
        0.111,
        ge=0,
        lt=0.5,
        description="mass of each flipper pair as a fraction of the robot's without a load; the "
        "default is nubot's [-]",
    )

    def array(self, ts: Transitions) -> FloatArray:
        """Return the rewards of M decisions in [-1, 0], (M,)."""
        robot, state = ts.robot, ts.after
        angles = (state.pitch, state.pitch + state.front, state.pitch - state.rear)
        forward, front, rear = map(_directions, angles)
        poses = contacts(ts.profile, robot, state.position, (forward, front, rear), self.touch)
        # The support lies between the outermost contacts.
        last, first = poses.outermost[..., 0]
        # Horizontal distance from the chassis' centre: each pair's mass lies halfway along it.
        centre = self.flipper_share * (poses.front[:, 0] + poses.rear[:, 0]) / 2
        x, z = load_offset(robot)
        centre *= 1 - load_share(robot)
        centre += x * forward[:, 0] - z * forward[:, 1]
        margin = np.where(poses.touching, np.minimum(centre - first, last - centre), -np.inf)
        penalty: FloatArray = 1.0 - np.clip(margin, 0.0, self.enough) / self.enough
        return -penalty


@reward("centring")
class Centring(RewardTerm):
    """Penalise a centre of mass far from the middle of the support.

    That is the middle between the rearmost and the foremost point at which the robot touches the
    ground. Mitriakov et al. (IEEE Robotics and Automation Magazine 28(4), 2021) penalise this
    distance on stairs: from a low centre over the middle the whole length of the tracks pushes. The
    reward is -1 in the air. The centre of mass includes the load.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    far: float = Field(0.5, ge=0.05, le=5, description="distance at which the reward is -1 [m]")
    touch: float = Field(
        0.01, gt=0, le=0.1, description="largest gap to the ground that counts as contact [m]"
    )

    def array(self, ts: Transitions) -> FloatArray:
        """Return the rewards of M decisions in [-1, 0], (M,)."""
        robot, state = ts.robot, ts.after
        angles = (state.pitch, state.pitch + state.front, state.pitch - state.rear)
        forward, front, rear = map(_directions, angles)
        poses = contacts(ts.profile, robot, state.position, (forward, front, rear), self.touch)
        # The middle of the support lies between its outermost contacts.
        middle = poses.outermost[0] / 2 + poses.outermost[1] / 2
        away = centre_of_mass(robot, forward, poses.front, poses.rear) - middle
        distance = np.where(poses.touching, np.hypot(*away.T), np.inf)
        penalty: FloatArray = np.minimum(distance / self.far, 1.0)
        return -penalty


@reward("clearance")
class Clearance(RewardTerm):
    """Penalise a small gap between the chassis' underside and bumps between the hinges.

    The reward is -1 if the underside touches a bump, and 0 without a bump. A tracked chassis may
    lie flat on level ground, but it gets caught and tips on an edge under its middle. As for a
    vehicle's breakover angle, a bump is therefore ground that rises above the straight line between
    the ground points below the two hinges. The noses of a stair, which the tracks climb, are bumps
    too: on stairs the term asks the flippers to carry the chassis.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    enough: float = Field(0.05, gt=0, le=1, description="smallest gap without a penalty [m]")
    bump: float = Field(
        0.02, ge=0, le=1, description="smallest rise above the line between the hinges [m]"
    )

    def array(self, ts: Transitions) -> FloatArray:
        """Return the rewards of M decisions in [-1, 0], (M,)."""
        cos, sin = _directions(ts.after.pitch).T
        (x, z), half = ts.after.position.T, ts.robot.hinge_offset * cos
        ground_x, ground_z = ts.profile.around_each(x, half, far=True)  # (M, P) [m]
        # A bump rises above the straight line between the ground below both hinges.
        begin, end = ts.profile.heights(x - half), ts.profile.heights(x + half)
        slope = (end - begin) / ((x + half) - (x - half))
        chord = begin[:, None] + slope[:, None] * (ground_x - (x - half)[:, None])
        # Height along the chassis' own normal, down to which the underside reaches
        up = cos[:, None] * (ground_z - z[:, None]) - sin[:, None] * (ground_x - x[:, None])
        is_bump = ground_z - chord > self.bump  # never for NaN
        highest = np.where(is_bump, up, -np.inf).max(axis=1, initial=-np.inf)  # in frame R [m]
        gap = -highest - ts.robot.track_radius  # infinite without a bump
        penalty = 1.0 - np.clip(gap, 0.0, self.enough) / self.enough
        return np.where(np.isinf(gap), 0.0, -penalty)


def _directions(angle: FloatArray) -> FloatArray:
    """Return unit vectors, (M, 2); numpy's cosine may differ from Python's in the last bit."""
    return np.array([(math.cos(a), math.sin(a)) for a in angle.tolist()]).reshape(-1, 2)
