"""How near the robot comes to tipping over: the energy stability margin."""

from collections.abc import Sequence

import numpy as np

from flipperctl.api import FloatArray, Measure, RobotStates, Transition, measure

from ..load import load_offset
from .masses import flipper_share

_TOUCH = 0.01
"""Largest gap to the ground that counts as contact [m]."""


@measure("energy_margin")
class EnergyMargin(Measure):
    """Mean normalised energy stability margin after each decision [m]."""

    unit = "m"
    digits = 3
    better = "higher"
    in_tables = False

    def __call__(self, episode: Sequence[Transition]) -> float:
        """Return the mean over the decisions [m]."""
        return float(margins(episode).mean())


@measure("energy_margin_min")
class SmallestEnergyMargin(Measure):
    """Smallest normalised energy stability margin after a decision [m]."""

    unit = "m"
    digits = 3
    better = "higher"
    in_tables = False

    def __call__(self, episode: Sequence[Transition]) -> float:
        """Return the smallest value, 0 if the robot tips or is in the air after a decision [m]."""
        return float(margins(episode).min())


def margins(episode: Sequence[Transition]) -> FloatArray:
    """Return the normalised energy stability margin after each decision, (M,) [m].

    It is the height by which the centre of mass must rise until the robot tips over the foremost
    or the rearmost point of contact, whichever is less: √(Δx² + Δz²) − Δz with the position
    (Δx, Δz) of the centre relative to that point. It is the energy that tips the robot over its
    weight (Hirose, Tsukagoshi and Yoneda 1998), in the side plane. It is 0 without a contact on
    both sides of the centre. The centre of mass is that of the robot with its load.
    """
    t = episode[0]
    robot, states = t.robot, RobotStates.of([t.after for t in episode])
    forward = _directions(states.pitch)  # (M, 2)
    ahead = robot.hinge_offset * forward  # (M, 2) [m], from the chassis centre
    front = ahead + robot.flipper_axle * _directions(states.pitch + states.front)
    rear = -ahead - robot.flipper_axle * _directions(states.pitch - states.rear)
    reach = robot.hinge_offset + robot.flipper_axle + robot.track_radius + _TOUCH
    x, z = t.profile.around_each(states.position[:, 0], reach, far=True)  # (M, P) [m]
    x, z = x - states.position[:, :1], z - states.position[:, 1:]
    axles = ((-ahead, ahead), (ahead, front), (rear, -ahead))
    gap = np.min([_distances(a, b, x, z) for a, b in axles], axis=0) - robot.track_radius
    touching = gap <= _TOUCH  # never for NaN
    # Each pair's mass lies halfway along it.
    centre = flipper_share(robot) * (front + rear) / 2  # (M, 2) [m]
    load_x, load_z = load_offset(robot)
    upward = np.column_stack([-forward[:, 1], forward[:, 0]])  # (M, 2)
    centre += load_x * forward + load_z * upward
    barriers = [_barriers(touching, x, z, centre, side) for side in (1.0, -1.0)]
    return np.minimum(*barriers)


def _barriers(
    touching: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    x: FloatArray,
    z: FloatArray,
    centre: FloatArray,
    side: float,
) -> FloatArray:
    """Return the rise [m] until the robot tips over its outermost contact on a side, (M,)."""
    outermost = np.argmax(np.where(touching, side * x, -np.inf), axis=1)
    rows = np.arange(len(x))
    across = side * (x[rows, outermost] - centre[:, 0])
    above = centre[:, 1] - z[rows, outermost]
    stands = touching[rows, outermost] & (across > 0)
    return np.where(stands, np.hypot(across, above) - above, 0.0)


def _directions(angle: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _distances(begin: FloatArray, end: FloatArray, x: FloatArray, z: FloatArray) -> FloatArray:
    """Return the distances (M, P) [m] of points from the segment of each row, ends (M, 2)."""
    along = end - begin
    x, z = x - begin[:, :1], z - begin[:, 1:]
    unit = along / (along * along).sum(axis=1, keepdims=True)
    fraction = np.clip(x * unit[:, :1] + z * unit[:, 1:], 0.0, 1.0)
    found: FloatArray = np.hypot(x - fraction * along[:, :1], z - fraction * along[:, 1:])
    return found
