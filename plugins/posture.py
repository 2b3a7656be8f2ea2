"""The robot's masses, its outline and what it touches, for rewards and measures.

A robot that is geometry alone carries no load and has nubot's masses and speed.
"""

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Profile, Robot, RobotGeometry


def with_masses(robot: RobotGeometry) -> Robot:
    """Return the robot with masses and speeds."""
    return robot if isinstance(robot, Robot) else Robot()


def load_share(robot: RobotGeometry) -> float:
    """Return the load's mass as a fraction of the loaded robot's [-]."""
    masses = with_masses(robot)
    return (masses.payload or 0.0) / masses.mass


def load_offset(robot: RobotGeometry) -> tuple[float, float]:
    """Return what the load adds to the robot's centre of mass, (x, z) in frame R [m]."""
    masses, share = with_masses(robot), load_share(robot)
    return share * (masses.payload_x or 0.0), share * (masses.payload_z or 0.0)


def centre_of_mass(
    robot: RobotGeometry, forward: FloatArray, front: FloatArray, rear: FloatArray
) -> FloatArray:
    """Return the centre of mass of M robots with their load, in each frame L, (M, 2) [m].

    ``forward``: unit vectors along the chassis; ``front``, ``rear``: ends of the flippers' axles,
    each (M, 2). A pair's mass lies halfway along it.
    """
    masses = with_masses(robot)
    load_x, load_z = load_offset(robot)
    upward = np.column_stack([-forward[:, 1], forward[:, 0]])
    pairs = masses.flipper_mass / masses.mass * (front + rear) / 2
    return pairs + (load_x * forward + load_z * upward)


def tipping_rise(across: FloatArray, above: FloatArray) -> FloatArray:
    """Return the rise of a centre of mass until the robot tips over a contact [m].

    The centre is ``across`` from the contact, at least 0, and ``above`` it [m]. The rise is
    √(across² + above²) − above. It is the energy that tips the robot, divided by its weight, in the
    side plane (Hirose, Tsukagoshi and Yoneda 1998).
    """
    rise: FloatArray = np.hypot(across, above) - above
    return rise


@dataclass(frozen=True)
class Contacts:
    """Where robots touch the ground in M poses, in each frame L."""

    front: FloatArray
    """Ends of the front flippers' axles, (M, 2) [m]."""
    rear: FloatArray
    """Ends of the rear flippers' axles, (M, 2) [m]."""
    x: FloatArray
    """Points of the ground near the robot, (M, P) [m]; NaN stands for no point."""
    z: FloatArray
    """(M, P) [m]"""
    touching: NDArray[np.bool_]
    """Whether the robot touches the point, (M, P)."""


def contacts(
    profile: Profile,
    robot: RobotGeometry,
    position: FloatArray,
    directions: tuple[FloatArray, FloatArray, FloatArray],
    touch: float,
) -> Contacts:
    """Return what M robots at ``position``, (M, 2) [m], touch: ground nearer than ``touch`` [m].

    ``directions``: unit vectors in frame L that point forward along the chassis, outward along the
    front flippers and forward along the rear ones, each (M, 2). The robot's outline is three
    capsules: the chassis and both flipper pairs.
    """
    chassis, front, rear = directions
    ahead = robot.hinge_offset * chassis
    front, rear = ahead + robot.flipper_axle * front, -ahead - robot.flipper_axle * rear
    reach = robot.reach + touch
    x, z = profile.around_each(position[:, 0], reach, far=True)
    x, z = x - position[:, :1], z - position[:, 1:]
    # The axes of the three capsules
    axles = ((-ahead, ahead), (ahead, front), (rear, -ahead))
    gap = np.sqrt(reduce(np.minimum, (_squares(a, b, x, z) for a, b in axles)))
    return Contacts(front, rear, x, z, gap - robot.track_radius <= touch)  # never for NaN


def _squares(begin: FloatArray, end: FloatArray, x: FloatArray, z: FloatArray) -> FloatArray:
    """Return the squared distances (M, P) [m²] of points from each row's segment, ends (M, 2)."""
    along = end - begin
    x, z = x - begin[:, :1], z - begin[:, 1:]
    # The nearest point of the segment, as a fraction of its length
    unit = along / (along * along).sum(axis=1, keepdims=True)
    fraction = np.clip(x * unit[:, :1] + z * unit[:, 1:], 0.0, 1.0)
    x, z = x - fraction * along[:, :1], z - fraction * along[:, 1:]
    squares: FloatArray = x * x + z * z
    return squares
