"""The energy balance of a robot, to which only servos and belts may add energy.

Chipmunk's solver iterates a fixed number of times. When a wedged robot comes free, the solver may
not have converged, and gives the bodies velocities that no force caused. Therefore the energy
gained in each sample is compared with what servos and belts can supply, and the velocities are
scaled down to remove the excess.

Both loops use these functions on plain numbers; one of them compiles the functions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flipperctl.api import SAMPLE_PERIOD, FloatArray, Robot

TOLERANCE = 1.0
"""Gain of energy in a sample that is allowed beyond the work of servos and belts [J].

Contacts that are pushed apart lift the robot: by 2.3 mm with 1 J, at 45 kg.
"""

_TRACTION = 3.0
"""Largest force of all belts together in the energy balance, in weights of the robot [-].

The engine does not limit the belts' motors and may report any force in a wedge.
"""

STATE = 6
"""Numbers of a body: x, z [m], angle [rad], velocity (x, z) [m/s], angular velocity [rad/s]."""


class Budget(NamedTuple):
    """Constants of a robot's energy balance."""

    gravity: float
    """Downward acceleration [m/s²]."""
    servos: float
    """Largest work of both servos in a sample [J]."""
    belts: float
    """Largest work of all belts in a sample [J]."""
    tolerance: float
    """Gain in a sample that is allowed beyond that work [J]."""
    ahead: float = 0.0
    """Distance of the loaded chassis' centre of mass ahead of its centre, in frame R [m]."""
    above: float = 0.0
    """Height of that centre of mass above the chassis centre, in frame R [m]."""

    @classmethod
    def of(cls, robot: Robot, gravity: float) -> Budget:
        """Return the constants of a robot."""
        servos = 2 * robot.flipper_torque * robot.flipper_speed  # [W]
        weight = robot.mass * gravity  # [N]
        belts = _TRACTION * weight * robot.track_speed  # [W]
        ahead, above = robot.centre_of_mass
        return cls(
            gravity=gravity,
            servos=servos * SAMPLE_PERIOD,
            belts=belts * SAMPLE_PERIOD,
            tolerance=TOLERANCE,
            ahead=ahead,
            above=above,
        )


def kinetic_energy(states: FloatArray, inertia: FloatArray) -> float:
    """Return the kinetic energy of bodies [J].

    ``states``: ``STATE`` numbers of each body, flat. ``inertia``: mass [kg] and moment of inertia
    [kg m²] of each body, (B, 2).
    """
    energy = 0.0
    for body in range(len(inertia)):
        at = STATE * body
        vx, vz, turning = states[at + 3], states[at + 4], states[at + 5]
        mass, moment = inertia[body, 0], inertia[body, 1]
        energy += 0.5 * (mass * (vx * vx + vz * vz) + moment * turning * turning)
    return float(energy)


def potential_energy(
    states: FloatArray,
    inertia: FloatArray,
    gravity: float,
    ahead: float = 0.0,
    above: float = 0.0,
) -> float:
    """Return the potential energy of bodies, 0 at z = 0 [J]; see ``kinetic_energy``.

    ``ahead`` and ``above``: centre of mass of the first body in its own frame [m]; those of the
    others lie at their positions.
    """
    energy = 0.0
    for body in range(len(inertia)):
        energy += inertia[body, 0] * gravity * states[STATE * body + 1]
    if ahead != 0.0 or above != 0.0:
        raised = math.sin(states[2]) * ahead + math.cos(states[2]) * above
        energy += inertia[0, 0] * gravity * raised
    return float(energy)


def slowdown(kinetic: float, excess: float) -> float:
    """Return the factor on all velocities that takes ``excess`` [J] from ``kinetic`` [J]."""
    return math.sqrt(max(0.0, kinetic - excess) / kinetic)
