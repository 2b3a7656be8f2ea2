"""How near the robot comes to tipping over: the energy stability margin."""

from collections.abc import Sequence

import numpy as np

from flipperctl.api import FloatArray, Transition, measure

from ..posture import centre_of_mass, contacts, tipping_rise
from .latest import stored

_TOUCH = 0.01
"""Largest gap to the ground that counts as contact [m]."""


@measure("energy_margin", unit="m", digits=3, better="higher", in_tables=False)
def energy_margin(episode: Sequence[Transition]) -> float:
    """Mean normalised energy stability margin after each decision [m]."""
    return float(margins(episode).mean())


@measure("energy_margin_min", unit="m", digits=3, better="higher", in_tables=False)
def energy_margin_min(episode: Sequence[Transition]) -> float:
    """Smallest normalised energy stability margin after a decision [m].

    It is 0 if the robot tips or is in the air after a decision.
    """
    return float(margins(episode).min())


@stored
def margins(episode: Sequence[Transition]) -> FloatArray:
    """Return the normalised energy stability margin after each decision, (M,) [m].

    It is the ``tipping_rise`` over the foremost or the rearmost point of contact, whichever is
    less, and 0 without a contact on both sides of the centre. The centre of mass includes the
    load.
    """
    profile, robot, states = episode[0].profile, episode[0].robot, [t.after for t in episode]
    rows = [(*s.position.tolist(), s.pitch, s.front, s.rear) for s in states]
    x, z, pitch, front, rear = np.array(rows).T
    position = np.column_stack([x, z])
    angles = np.array([pitch, pitch + front, pitch - rear])
    forward, front, rear = np.stack([np.cos(angles), np.sin(angles)], axis=-1)  # each (M, 2)
    poses = contacts(profile, robot, position, (forward, front, rear), _TOUCH)
    centre = centre_of_mass(robot, forward, poses.front, poses.rear)
    # Tipping ahead over the foremost contact, and back over the rearmost one
    x, z = poses.outermost.transpose(2, 0, 1)  # each (2, M)
    across, above = np.array([[1.0], [-1.0]]) * (x - centre[:, 0]), centre[:, 1] - z
    stands = poses.touching & (across > 0)
    least: FloatArray = np.where(stands, tipping_rise(across, above), 0.0).min(axis=0)
    return least
