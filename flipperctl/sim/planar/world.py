"""The pymunk world: a three-part robot on a profile.

In: a profile, the robot, the engine's settings and a start. Out: the robot's pose every 10 ms, and
its whole ``RobotState`` on request. The engine's y is the world's z; its angles are positive nose
up.
"""

from __future__ import annotations

import math
from itertools import groupby, pairwise
from typing import Any

import numpy as np
import pymunk

from flipperctl.api import (
    NO_LIMITS,
    SAMPLE_PERIOD,
    FloatArray,
    Limits,
    Profile,
    Robot,
    RobotState,
    Start,
)
from flipperctl.core.building import built
from flipperctl.sim.ground import height_at
from flipperctl.sim.planar import Planar
from flipperctl.sim.planar.compiled import GROUND, STATE, TRACK, Belt, Budget, CompiledLoop
from flipperctl.sim.planar.rays import distances

_LEVEL_GROUND = 20.0  # length of the level ground before and past the profile [m]
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


class PlanarWorld:
    """One robot on one profile; rebuilt for every episode, so that replays are bit-identical."""

    def __init__(self, profile: Profile, robot: Robot, sim: Planar, start: Start) -> None:
        """Place the robot at ``start``.

        Without a height there, it rests on the lower flippers if a flipper is below the level
        chassis, else on the chassis.
        """
        self.robot, self.sim, self.profile = robot, sim, profile
        self._time = 0.0
        self._share = 1.0
        # Bodies may overlap by as much as thinning moves the ground.
        self.space = space = pymunk.Space()
        space.gravity = (0.0, -sim.gravity)
        space.iterations = sim.iterations
        space.collision_slop = 1e-4
        space.collision_bias = 0.2**60  # Chipmunk's default is far too soft at these substeps
        self._add_ground()

        # The chassis with its load, and the flippers at its hinges
        centre, half = (start.x, height_at(start, profile, robot)), robot.hinge_offset
        self._chassis = self._add_part(robot.chassis_mass, centre, start.pitch, 2 * half)
        if robot.payload:
            inertia = self._chassis.moment + sum(robot.load_inertia)
            self._chassis.mass, self._chassis.moment = robot.carried_mass, inertia
            self._chassis.center_of_gravity = robot.centre_of_mass
            self._chassis.position = centre  # Chipmunk keeps the place of the centre of mass
        self._front, self._front_gear = self._add_flipper(half, start.front)
        self._rear, self._rear_gear = self._add_flipper(-half, start.rear)
        self._bodies = self._chassis, self._front, self._rear
        # The belts' limits, and the compiled loop that steps the space
        grip = math.inf  # normal impulses of a substep from which the motors limit the belts [N s]
        if robot.track_force is not None:
            grip = robot.track_force * sim.substep / sim.friction
        self._loop = CompiledLoop(
            space,
            self._bodies,
            Belt(robot.track_speed, _IMPULSE_SPEED * robot.mass, grip),
            Budget.of(robot, sim.gravity),
            sim.substep,
            round(SAMPLE_PERIOD / sim.substep),
            (self._front_gear, self._rear_gear),
        )

    def _add_ground(self) -> None:
        self._line = self.profile.extended(_LEVEL_GROUND, _LEVEL_GROUND)
        # Repeated points would make segments without a length.
        line = [point for point, _ in groupby(map(tuple, self._line.tolist()))]
        ground = self.space.static_body
        segments = [pymunk.Segment(ground, a, b, 0.0) for a, b in pairwise(line)]
        # With its neighbours, a segment does not catch what slides over the crack between them.
        for i, segment in enumerate(segments):
            segment.set_neighbors(line[max(i - 1, 0)], line[min(i + 2, len(line) - 1)])
            segment.friction = self.sim.friction
            segment.collision_type = GROUND
        self.space.add(*segments)

    def _add_part(self, mass: float, centre: Any, angle: float, axle: float) -> pymunk.Body:
        a, b = (-axle / 2, 0.0), (axle / 2, 0.0)
        radius = self.robot.track_radius
        body = pymunk.Body(mass, pymunk.moment_for_segment(mass, a, b, radius))
        body.position, body.angle = centre, angle
        shape = pymunk.Segment(body, a, b, radius)
        shape.friction = 1.0  # Chipmunk multiplies the two shapes' friction
        shape.collision_type = TRACK
        # The robot's parts do not collide with each other.
        shape.filter = pymunk.ShapeFilter(group=1)
        self.space.add(body, shape)
        return body

    def _add_flipper(self, hinge_x: float, angle: float) -> tuple[pymunk.Body, pymunk.GearJoint]:
        """Add a flipper pair; return it and its servo, which holds the present angle."""
        robot, pitch, side = self.robot, self._chassis.angle, math.copysign(1.0, hinge_x)
        # The flipper's place, in the engine's angles
        turned = pitch + side * angle  # the engine's angle
        hinge = self._chassis.position + pymunk.Vec2d(hinge_x, 0.0).rotated(pitch)
        reach = side * robot.flipper_axle / 2
        centre = hinge + pymunk.Vec2d(reach, 0.0).rotated(turned)
        body = self._add_part(robot.flipper_mass, centre, turned, robot.flipper_axle)
        # The hinge, with bounded force and speed so that a wedged robot is not thrown off
        pivot = pymunk.PivotJoint(self._chassis, body, (hinge_x, 0.0), (-reach, 0.0))
        pivot.max_bias = _CLOSING_SPEED
        pivot.max_force = _IMPULSE_SPEED * robot.mass / self.sim.substep
        # A gear joint of ratio 1 holds the angle `phase` with at most the rate `max_bias` and the
        # torque `max_force`: a rate- and torque-limited servo without a callback.
        servo = pymunk.GearJoint(self._chassis, body, body.angle - pitch, 1.0)
        servo.max_bias, servo.max_force = robot.flipper_speed, robot.flipper_torque
        # End stops, a little past the largest target so that the servo holds it undisturbed
        largest = robot.angle_limit + _STOP_PLAY
        stop = pymunk.RotaryLimitJoint(self._chassis, body, -largest, largest)
        stop.max_bias = _STOP_RETURN * robot.flipper_speed
        for joint in (pivot, servo, stop):  # the solver's order
            joint.error_bias = 0.0
            self.space.add(joint)
        return body, servo

    def command(self, front: float, rear: float) -> None:
        """Set the target angles of the flippers in frame R [rad]."""
        self._front_gear.phase = front
        self._rear_gear.phase = -rear

    def run_belts(self, share: float) -> None:
        """Run the belts at a share of the robot's speed, from -1 to 1."""
        self._share = share
        self._loop.run_belts(share * self.robot.track_speed)

    def advance(self, samples: int = 1, limits: Limits = NO_LIMITS) -> FloatArray:
        """Simulate up to ``samples`` sample periods; return the pose at the end of each, (S, 5)."""
        poses = np.empty((samples, 5))
        done = self._loop.run(poses, limits)
        self._time += done * SAMPLE_PERIOD
        return poses[:done]

    @property
    def position(self) -> tuple[float, float]:
        """World coordinates (x, z) of the chassis centre [m]."""
        return self._chassis.position

    def flipper_work(self) -> float:
        """Return the work of the servos since the start; see ``CompiledLoop.spent`` [J]."""
        return self._loop.spent

    def penetration(self) -> float:
        """Return the largest depth by which the robot overlaps the ground [m]."""
        hits = [h for b in self._bodies for s in b.shapes for h in self.space.shape_query(s)]
        depths = (
            -point.distance
            for hit in hits
            if hit.shape is not None and hit.shape.collision_type == GROUND
            for point in hit.contact_point_set.points
        )
        return max([0.0, *depths])

    def cast_rays(self, origin: FloatArray, directions: FloatArray, reach: float) -> FloatArray:
        """Return the distance from ``origin`` to the ground along each direction, (R,) [m].

        See ``flipperctl.api.RayWorld``; the ground is the same at every world y.
        """
        return distances(self._line, origin[[0, 2]], directions[:, [0, 2]], reach)

    @property
    def pitch(self) -> float:
        """Pitch of the chassis, nose up positive [rad]."""
        return float(self._chassis.angle)

    @property
    def time(self) -> float:
        """Time since the start of the episode [s]."""
        return self._time

    def state(self) -> RobotState:
        """Return the current state."""
        states = self._loop.states()
        velocity = states[3:5].copy()
        if self.robot.payload:  # else the centre of mass is the chassis centre
            velocity = np.array(self._chassis.velocity_at_local_point((0.0, 0.0)))
        pitch, front, rear = states[2::STATE].tolist()
        return built(
            RobotState,
            position=states[:2].copy(),
            pitch=pitch,
            front=front - pitch,
            rear=pitch - rear,
            velocity=velocity,
            pitch_rate=float(states[5]),
            time=self._time,
            belts=None if self._share == 1.0 else np.full(2, self._share * self.robot.track_speed),
        )

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot of poses, velocities and flipper targets for ``load``.

        It lacks the engine's contact impulses, so that a loaded run differs from an uninterrupted
        one. The median difference is 5e-5 m per decision; hard contacts reach 0.02 m.
        """
        bodies = [(b.position, b.angle, b.velocity, b.angular_velocity) for b in self._bodies]
        return bodies, self._front_gear.phase, self._rear_gear.phase, self._time

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        bodies, self._front_gear.phase, self._rear_gear.phase, self._time = saved
        for body, pose in zip(self._bodies, bodies, strict=True):
            # The angle first, as the position depends on it if a load shifts the centre of mass.
            position, body.angle, body.velocity, body.angular_velocity = pose
            body.position = position
        self._loop.forget()
