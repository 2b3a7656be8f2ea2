"""The joint of a flipper pair with the chassis: hinge, servo and end stops.

In: two bodies of a space, and the robot. Out: the servo, whose ``phase`` is the target angle.

Chipmunk corrects an error of a joint by a real velocity and an overlap of bodies by a shift. When
a robot is wedged between two faces, the two corrections conflict; without bounds the solver's
cached impulses grew to 9,000 N s, 200 times those of a hard landing. When one contact of the wedge
opened, the others threw the robot away with up to 2,000 J. Bounds on the hinges and on the contacts
(``largest_impulse``) prevent this; no ordinary motion reaches them.
"""

from __future__ import annotations

import pymunk

from flipperctl.api import Robot

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
