"""The belts, the joint of a flipper pair with the chassis, and the energy balance of a robot.

In: two bodies of a space, and the robot. Out: the servo, whose ``phase`` is the target angle. Only
servos and belts may add energy. Chipmunk corrects an error of a joint by a real velocity and an
overlap of bodies by a shift. When a robot is wedged between two faces, the two corrections
conflict; without bounds the solver's cached impulses grew to 9,000 N s, 200 times those of a hard
landing. When it comes free, the solver may not have converged, and gives the bodies velocities that
no force caused. Therefore the energy gained in each sample is compared with what servos and belts
can supply, and the velocities are scaled down to remove the excess.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import pymunk

from flipperctl.api import SAMPLE_PERIOD, FloatArray, Robot

TOLERANCE = 1.0
"""Gain of energy in a sample that is allowed beyond the work of servos and belts [J].

Contacts that are pushed apart lift the robot: by 2.3 mm with 1 J, at 45 kg.
"""

_TRACTION = 3.0
"""Largest force of all belts together in the energy balance, in weights of the robot [-].

The engine does not limit the belts' motors and may report any force in a wedge.
"""

TRACK, GROUND = 1, 2
"""Collision types of the tracks and of the ground."""


class Belt(NamedTuple):
    """Values that a callback sets at each contact of a track with the ground."""

    speed: float
    """Speed of the belt's surface along the outline [m/s]."""
    largest: float
    """Largest impulse that a contact caches from one substep for the next [N s]."""
    grip: float = math.inf
    """Sum of the normal impulses of a substep up to which friction alone limits the belts [N s].

    With more, the friction of the next substep is scaled down, so that all belts together push with
    no more than their motors' force. A belt that is held by its load slips as one that lacks grip.
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


_IMPULSE_SPEED = 1.25
"""Largest impulse of a hinge in a substep, and largest cached impulse of a contact, per mass of
the robot [m/s]: 56 N s for 45 kg, or 11 kN over a substep of 5 ms.

Rule-based controllers reach 20 N s at the hinges and 40 N s at contacts, in landings.
"""
_CLOSING_SPEED = 0.5
"""Largest speed at which a hinge corrects its error [m/s]; rule-based controllers need 0.4 m/s."""
_STOP_PLAY = 1e-3
"""Distance of the end stops past the largest target [rad], so that servos hold it undisturbed."""
_STOP_RETURN = 0.1
"""Speed at which a stop pushes a flipper back, as a fraction of the servo's [-].

A flipper passes its stop for one substep before Chipmunk stops it. A slow return gives back little
of the energy that pushed it there.
"""


def largest_impulse(robot: Robot) -> float:
    """Return the largest impulse of a hinge, and the largest cached impulse of a contact [N s]."""
    return _IMPULSE_SPEED * robot.mass


def join(
    chassis: pymunk.Body, flipper: pymunk.Body, hinge_x: float, robot: Robot, substep: float
) -> pymunk.GearJoint:
    """Join a flipper pair with the chassis and return its servo, which holds the present angle.

    ``hinge_x``: x of the hinge on the chassis [m], negative for the rear pair.
    """
    reach = robot.flipper_axle / 2 if hinge_x > 0 else -robot.flipper_axle / 2
    hinge = pymunk.PivotJoint(chassis, flipper, (hinge_x, 0.0), (-reach, 0.0))
    hinge.error_bias = 0.0
    hinge.max_bias = _CLOSING_SPEED
    hinge.max_force = largest_impulse(robot) / substep
    # A gear joint of ratio 1 holds the angle `phase` with at most the rate `max_bias` and the
    # torque `max_force`: a rate- and torque-limited servo without a callback.
    servo = pymunk.GearJoint(chassis, flipper, flipper.angle - chassis.angle, 1.0)
    servo.max_bias = robot.flipper_speed
    servo.max_force = robot.flipper_torque
    servo.error_bias = 0.0
    largest = robot.angle_limit + _STOP_PLAY
    stop = pymunk.RotaryLimitJoint(chassis, flipper, -largest, largest)
    stop.max_bias = _STOP_RETURN * robot.flipper_speed
    stop.error_bias = 0.0
    assert chassis.space is not None
    chassis.space.add(hinge, servo, stop)  # the solver's order
    return servo
