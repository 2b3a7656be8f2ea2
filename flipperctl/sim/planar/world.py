"""The pymunk world: a three-part robot on a profile.

In: a profile, the robot, the engine's settings and a start. Out: the robot's pose every 10 ms, and
its whole ``RobotState`` on request. The engine's y is the world's z; its angles are positive nose
up.
"""

from __future__ import annotations

import math
from itertools import pairwise
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
from flipperctl.sim.planar.compiled import CompiledLoop
from flipperctl.sim.planar.joints import GROUND, TRACK, Belt, Budget, join, largest_impulse
from flipperctl.sim.planar.rays import distances
from flipperctl.sim.planar.settings import PlanarSettings
from flipperctl.sim.resting import height_at

_LEVEL_GROUND = 20.0  # length of the level ground before and past the profile [m]


class PlanarWorld:
    """One robot on one profile; rebuilt for every episode, so that replays are bit-identical."""

    def __init__(self, profile: Profile, robot: Robot, sim: PlanarSettings, start: Start) -> None:
        """Place the robot at ``start``.

        Without a height there, it rests on the lower flippers if a flipper is below the level
        chassis, else on the chassis.
        """
        self.robot, self.sim, self.profile = robot, sim, profile
        self._time = 0.0
        self.space = space = pymunk.Space()
        space.gravity = (0.0, -sim.gravity)
        space.iterations = sim.iterations
        space.collision_slop = 1e-4
        space.collision_bias = 0.2**60  # Chipmunk's default is far too soft at these substeps
        self._add_ground()

        centre = (start.x, height_at(start, profile, robot))
        half = robot.hinge_offset
        self._chassis = self._add_chassis(centre, start.pitch, 2 * half)
        self._front, self._front_gear = self._add_flipper(half, start.front)
        self._rear, self._rear_gear = self._add_flipper(-half, start.rear)
        self._loop = CompiledLoop(
            space,
            (self._chassis, self._front, self._rear),
            Belt(robot.track_speed, largest_impulse(robot), self._grip),
            Budget.of(robot, sim.gravity),
            sim.substep,
            round(SAMPLE_PERIOD / sim.substep),
            (self._front_gear, self._rear_gear),
        )

    def _add_ground(self) -> None:
        self._line = self.profile.extended(_LEVEL_GROUND, _LEVEL_GROUND)
        line = [tuple(p) for p in self._line.tolist()]
        line = [p for i, p in enumerate(line) if i == 0 or p != line[i - 1]]
        ground = self.space.static_body
        segments = [pymunk.Segment(ground, a, b, 0.0) for a, b in pairwise(line)]
        for i, segment in enumerate(segments):
            segment.set_neighbors(line[max(i - 1, 0)], line[min(i + 2, len(line) - 1)])
            segment.friction = self.sim.friction
            segment.collision_type = GROUND
        self.space.add(*segments)

    @property
    def _grip(self) -> float:
        """Normal impulses of a substep from which the tracks' motors limit the belts [N s]."""
        force = self.robot.track_force
        return math.inf if force is None else force * self.sim.substep / self.sim.friction

    def _add_chassis(self, centre: tuple[float, float], angle: float, axle: float) -> pymunk.Body:
        robot = self.robot
        body = self._add_part(robot.chassis_mass, centre, angle, axle)
        if robot.payload:
            body.mass, body.moment = robot.carried_mass, body.moment + sum(robot.load_inertia)
            body.center_of_gravity = robot.centre_of_mass
            body.position = centre  # Chipmunk keeps the place of the centre of mass
        return body

    def _add_part(
        self, mass: float, centre: tuple[float, float], angle: float, axle: float
    ) -> pymunk.Body:
        a, b = (-axle / 2, 0.0), (axle / 2, 0.0)
        radius = self.robot.track_radius
        body = pymunk.Body(mass, pymunk.moment_for_segment(mass, a, b, radius))
        body.position = centre
        body.angle = angle
        shape = pymunk.Segment(body, a, b, radius)
        shape.friction = 1.0  # Chipmunk multiplies the two shapes' friction
        shape.collision_type = TRACK
        shape.filter = pymunk.ShapeFilter(group=1)
        self.space.add(body, shape)
        return body

    def _add_flipper(self, hinge_x: float, angle: float) -> tuple[pymunk.Body, pymunk.GearJoint]:
        robot = self.robot
        side = math.copysign(1.0, hinge_x)
        pitch = self._chassis.angle
        turned = pitch + side * angle  # the engine's angle
        hinge = self._chassis.position + pymunk.Vec2d(hinge_x, 0.0).rotated(pitch)
        reach = side * robot.flipper_axle / 2
        centre = hinge + pymunk.Vec2d(reach, 0.0).rotated(turned)
        body = self._add_part(robot.flipper_mass, centre, turned, robot.flipper_axle)
        return body, join(self._chassis, body, hinge_x, robot, self.sim.substep)

    def command(self, front: float, rear: float) -> None:
        """Set the target angles of the flippers in frame R [rad]."""
        self._front_gear.phase = front
        self._rear_gear.phase = -rear

    def advance(self, samples: int = 1, limits: Limits = NO_LIMITS) -> FloatArray:
        """Simulate up to ``samples`` sample periods; return the pose at the end of each.

        The poses are (S, 5): x [m], z [m], pitch, front and rear flipper angle [rad]. The run
        stops after the sample at which the chassis reaches a limit.
        """
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
        depth = 0.0
        for body in (self._chassis, self._front, self._rear):
            for shape in body.shapes:
                for hit in self.space.shape_query(shape):
                    if hit.shape is not None and hit.shape.collision_type == GROUND:
                        points = hit.contact_point_set.points
                        depth = max([depth, *(-p.distance for p in points)])
        return depth

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
        chassis = self._chassis
        pitch, velocity = chassis.angle, chassis.velocity
        if self.robot.payload:  # else the centre of mass is the chassis centre
            velocity = chassis.velocity_at_local_point((0.0, 0.0))
        return RobotState(
            position=np.array(chassis.position),
            pitch=pitch,
            front=self._front.angle - pitch,
            rear=pitch - self._rear.angle,
            velocity=np.array(velocity),
            pitch_rate=chassis.angular_velocity,
            time=self._time,
        )

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot of poses, velocities and flipper targets for ``load``.

        It lacks the engine's contact impulses, so a loaded run differs from an uninterrupted one,
        by 5e-5 m per decision at the median and by up to 0.02 m at hard contacts.
        """
        bodies = [
            (b.position, b.angle, b.velocity, b.angular_velocity)
            for b in (self._chassis, self._front, self._rear)
        ]
        return bodies, self._front_gear.phase, self._rear_gear.phase, self._time

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        bodies, self._front_gear.phase, self._rear_gear.phase, self._time = saved
        for body, pose in zip((self._chassis, self._front, self._rear), bodies, strict=True):
            # The angle first, as the position depends on it if a load shifts the centre of mass.
            position, body.angle, body.velocity, body.angular_velocity = pose
            body.position = position
        self._loop.forget()
