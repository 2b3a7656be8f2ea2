"""The robot's masses, its outline and what it touches, for rewards and measures.

A robot that is geometry alone carries no load and has nubot's masses and speed.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

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


class Contacts(NamedTuple):
    """Where robots touch the ground in M poses, in each frame L."""

    front: FloatArray
    """Ends of the front flippers' axles, (M, 2) [m]."""
    rear: FloatArray
    """Ends of the rear flippers' axles, (M, 2) [m]."""
    outermost: FloatArray
    """The foremost and the rearmost point that the robot touches, (2, M, 2) [m]; 0 in the air."""
    touching: NDArray[np.bool_]
    """Whether the robot touches the ground, (M,)."""


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
    # The axes of the three capsules, (3, M, 2)
    begin = np.array([-ahead, ahead, rear])
    along = np.array([ahead, front, -ahead]) - begin
    unit = along / (along * along).sum(axis=-1, keepdims=True)
    # The ground within reach, as indices of the profile's points on endless level ground
    reach, x = robot.reach + touch, position[:, 0]
    first, last = profile.indices(x - reach), profile.indices(x + reach)
    outermost, touching = np.zeros((2, len(x), 2)), np.zeros(len(x), np.bool_)
    compiled(_search)(
        *(profile.cloud, profile.spacing, first, last, np.array(position), begin, along, unit),
        *(robot.track_radius, touch, outermost, touching),
    )
    return Contacts(front, rear, outermost, touching)


@cache
def compiled(function: Callable[..., None]) -> Callable[..., None]:
    """Return a function as machine code."""
    from numba import njit  # takes a third of a second to import

    from flipperctl.api.jit import cached

    code: Callable[..., None] = cached(njit)(function)
    return code


def _search(
    cloud: FloatArray,
    spacing: float,
    first: NDArray[np.intp],
    last: NDArray[np.intp],
    position: FloatArray,
    begin: FloatArray,
    along: FloatArray,
    unit: FloatArray,
    radius: float,
    touch: float,
    outermost: FloatArray,
    touching: NDArray[np.bool_],
) -> None:
    """Fill in ``outermost`` and ``touching`` of ``Contacts``.

    From the first point to the one before the last, each pose is searched from both ends. Points
    before and past the ``cloud`` (P, 2) go on ``spacing`` [m] apart. The capsules' axes are
    ``begin`` and ``along``, (3, M, 2) [m]; ``unit`` is ``along`` over its squared length.
    """
    for pose in range(len(position)):
        for end in range(2):
            for step in range(last[pose] - first[pose]):
                index = first[pose] + step if end else last[pose] - 1 - step
                inside = min(max(index, 0), len(cloud) - 1)
                x = cloud[inside, 0] + (index - inside) * spacing - position[pose, 0]
                z = cloud[inside, 1] - position[pose, 1]
                # Of a vertical face, the lowest point in the order of the outline counts.
                if touching[pose] and end == 0 and x < outermost[0, pose, 0]:
                    break
                least = math.inf
                for axis in range(3):
                    ahead, above = x - begin[axis, pose, 0], z - begin[axis, pose, 1]
                    # The nearest point of the axis, as a fraction of its length
                    share = ahead * unit[axis, pose, 0] + above * unit[axis, pose, 1]
                    share = min(max(share, 0.0), 1.0)
                    ahead -= share * along[axis, pose, 0]
                    above -= share * along[axis, pose, 1]
                    least = min(least, ahead * ahead + above * above)
                if math.sqrt(least) - radius <= touch:
                    touching[pose] = True
                    outermost[end, pose, 0], outermost[end, pose, 1] = x, z
                    if end:
                        break
