"""MuJoCo's model of the scene: the ground's boxes and the robot with its tracks and flippers.

In: boxes, the robot and the engine's settings. Out: a compiled model, and the velocities and sides
of its belts. Frames: x forward, y to the left, z up.

A track is a box between two capsules that lie across it. Its belt is MuJoCo's ``surfacevel``: an
angular velocity about each part's own centre, whose tangential part acts at contacts. That is the
belt's speed along the whole outline. A capsule is round, and both faces of the box have the same
distance from the centre everywhere. Cylinders as ends would stall at edges, where MuJoCo gives
them a horizontal normal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from flipperctl.api import SAMPLE_PERIOD, FloatArray, Profile, Robot
from flipperctl.sim.mujoco.ground import LEVEL_GROUND, Box
from flipperctl.sim.mujoco.settings import MujocoSettings
from flipperctl.sim.outline import BELT, CHASSIS, EARTH, FRONT, REAR

_RECESS = 5e-4
"""The boxes of the tracks lie this far inside the outline [m].

On level ground only the capsules touch, which halves the contacts.
"""
_ACROSS = (math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0)  # turns a capsule's axis from z to y
_CONTACT = {"solref": [0.02, 1.5], "solimp": [0.8, 0.9, 0.001, 0.5, 2.0]}
"""Time constant [s], damping ratio and stiffness of contacts.

MuJoCo's friction is convex: a contact that slips at v is pushed apart by about μ·v times the time
constant, and hops once that is more than the depth at which it rests. A robot that is stopped by a
wall, and slips at 0.2 m/s, then vibrates and climbs too slowly. Of twelve values, these soft and
overdamped ones hop least at the default substep; statics are not affected.
"""
_SLIP = 10.0
"""Stiffness of friction as a multiple of the contacts', so that a held robot does not creep [-]."""
_ROTOR_INERTIA = 1.0  # inertia of a flipper's geared motor at its hinge; a guess [kg m²]
_SERVO = 2000.0
"""Torque of a flipper's servo for each rad/s of velocity error [N m s/rad], before its limit."""
ROBOT_GROUP = 1
"""Group of the robot's shapes, which rays pass through; the ground is in group 0 [-]."""
_STOP_PLAY = 1e-3  # distance of the end stops past the largest target [rad], as in sim=planar


class Model(NamedTuple):
    """A compiled scene."""

    model: Any
    """``mujoco.MjModel``; the robot's free joint comes first, then the flippers' hinges, in the
    order front left, rear left, front right, rear right."""
    belts: FloatArray  # (G, 6) ``geom_surfacevel`` of belts that run at the robot's speed
    sides: FloatArray  # (G,) 1 for parts on the left, -1 for those on the right, 0 for the ground


def build(spec: Any) -> Model:
    """Compile the scene; the robot's pose is set in its data."""
    model = spec.compile()
    names = [model.geom(i).name for i in range(model.ngeom)]
    sides = [1.0 if n.endswith("left") else -1.0 if n.endswith("right") else 0.0 for n in names]
    return Model(model, model.geom_surfacevel.copy(), np.array(sides))


def specify(ground: Sequence[Box], robot: Robot, sim: MujocoSettings) -> Any:
    """Return the ``mujoco.MjSpec`` of the scene, with the chassis at the origin."""
    spec = mujoco.MjSpec()
    # Units and solver
    spec.compiler.degree = False
    option = spec.option
    option.timestep = sim.substep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = _SLIP
    # Gravity is tilted instead of the ground, which is equivalent and keeps boxes upright.
    slope = sim.handed * sim.lateral_slope
    option.gravity = [0.0, -sim.gravity * math.sin(slope), -sim.gravity * math.cos(slope)]
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # divergence must be seen
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)  # one robot is one island
    # The masks let the robot touch the ground, but neither the robot nor the ground touch itself.
    for box in ground:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=box.centre,
            size=box.half,
            quat=_quaternion(box),
            contype=0,
            conaffinity=1,
            rgba=rgba(EARTH),
            **_surface(sim),
        )
    _add_robot(spec, robot, sim)
    return spec


def _quaternion(box: Box) -> list[float]:
    """Return (w, x, y, z) of a box that is tilted and then turned about the vertical."""
    cos, sin = math.cos(box.tilt / 2), math.sin(box.tilt / 2)
    w, z = math.cos(box.turn / 2), math.sin(box.turn / 2)
    return [cos * w, 0.0 + sin * z, -sin * w, cos * z]


def rgba(colour: str) -> list[float]:
    """Return a colour as in HTML as red, green, blue and opacity, from 0 to 1."""
    return [*(part / 255 for part in bytes.fromhex(colour[1:])), 1.0]


def _surface(sim: MujocoSettings) -> dict[str, Any]:
    return {"friction": [sim.friction, 0.0, 0.0], "condim": 3, **_CONTACT}


def _add_robot(spec: Any, robot: Robot, sim: MujocoSettings) -> None:
    half, width = robot.hinge_offset, sim.track_width
    # The chassis, with its inertia and its load
    chassis = spec.worldbody.add_body(name="chassis")
    chassis.add_freejoint(name="chassis")
    outer = sim.flipper_offset + width / 2
    size = robot.chassis_length, 2 * outer, 2 * robot.track_radius
    _set_inertia(chassis, mass=robot.chassis_mass, size=size, centre=0.0)
    if robot.payload:
        _add_load(chassis, robot)
    # Main tracks, each between two drums
    for side, sign in (("left", 1.0), ("right", -1.0)):
        inner = sim.main_track_offset - width / 2
        middle = sign * sim.main_track_offset
        _add_board(chassis, f"main_{side}", (-half, half), middle, robot, sim, CHASSIS)
        for end, x in (("front", half), ("rear", -half)):
            # One drum for the ends of main track and flipper, which turn about the same axle.
            y, half_width = sign * (inner + outer) / 2, (outer - inner) / 2
            _add_end(chassis, f"{end}_drum_{side}", (x, y), half_width, robot, sim)
    _add_cameras(chassis, robot, sim)
    # In the order that ``Model`` states
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for end, ahead, colour in (("front", 1.0, FRONT), ("rear", -1.0, REAR)):
            flipper = chassis.add_body(
                name=f"{end}_{side}", pos=[ahead * half, sign * sim.flipper_offset, 0.0]
            )
            reach = ahead * robot.flipper_axle
            size = robot.flipper_length, width, 2 * robot.track_radius
            _set_inertia(flipper, mass=robot.flipper_mass / 2, size=size, centre=reach / 2)
            _add_board(flipper, f"{end}_board_{side}", (0.0, reach), 0.0, robot, sim, colour)
            _add_end(flipper, f"{end}_tip_{side}", (reach, 0.0), width / 2, robot, sim)
            _add_hinge(spec, flipper, f"{end}_{side}", -ahead, robot, sim)


def _add_cameras(chassis: Any, robot: Robot, sim: MujocoSettings) -> None:
    """Add the cameras above the hinges; one looks along its negative z axis, its y axis is up."""
    cos, sin = math.cos(sim.camera_tilt), math.sin(sim.camera_tilt)
    for name, ahead in (("front", 1.0), ("rear", -1.0)):
        # The rows are the camera's x, y and z axes in frame R.
        axes = np.array([[0.0, -ahead, 0.0], [ahead * sin, 0.0, cos], [-ahead * cos, 0.0, sin]])
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, axes.T.ravel())
        place = [ahead * robot.hinge_offset, 0.0, sim.camera_height]
        chassis.add_camera(name=name, pos=place, quat=quat, fovy=math.degrees(sim.camera_angle))


def _set_inertia(
    body: Any, *, mass: float, size: tuple[float, float, float], centre: float
) -> None:
    """Set the mass [kg] and the inertia of a box around x = ``centre`` [m].

    ``size``: length, width and height [m]. In the side plane, the inertia equals that of the
    capsule in the planar engine.
    """
    length, width, height = size
    body.mass, body.ipos, body.explicitinertial = mass, [centre, 0.0, 0.0], True
    squares = width**2 + height**2, length**2 + height**2, length**2 + width**2
    body.inertia = [mass * s / 12 for s in squares]


def _add_load(chassis: Any, robot: Robot) -> None:
    """Add the robot's load, a point, to the inertia of its chassis."""
    ahead, above = robot.load_inertia
    x, z = robot.centre_of_mass
    product = math.copysign(math.sqrt(ahead * above), -x * z)  # of inertia, about x and z
    across, along, upright = chassis.inertia.tolist()
    chassis.mass, chassis.ipos = robot.carried_mass, [x, 0.0, z]
    chassis.inertia = [0.0, 0.0, 0.0]
    chassis.fullinertia = [across + above, along + ahead + above, upright + ahead, 0, product, 0]


def _add_end(
    body: Any,
    name: str,
    at: tuple[float, float],
    half: float,
    robot: Robot,
    sim: MujocoSettings,
) -> None:
    """Add a round end at (x, y) [m], a capsule whose straight part is as wide as the belt.

    ``half``: half the width of the belt [m].
    """
    radius = robot.track_radius
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        size=[radius, half, 0.0],
        pos=[*at, 0.0],
        quat=_ACROSS,
        surfacevel=[0.0, 0.0, 0.0, 0.0, 0.0, robot.track_speed / radius],
        contype=1,
        conaffinity=0,
        group=ROBOT_GROUP,
        rgba=rgba(BELT),
        **_surface(sim),
    )


def _add_board(
    body: Any,
    name: str,
    along: tuple[float, float],
    y: float,
    robot: Robot,
    sim: MujocoSettings,
    colour: str,
) -> None:
    """Add the straight part of a track between two x [m]."""
    height = robot.track_radius - _RECESS
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[abs(along[1] - along[0]) / 2, sim.track_width / 2, height],
        pos=[sum(along) / 2, y, 0.0],
        surfacevel=[0.0, 0.0, 0.0, 0.0, robot.track_speed / height, 0.0],
        contype=1,
        conaffinity=0,
        group=ROBOT_GROUP,
        rgba=rgba(colour),
        **_surface(sim),
    )


def _add_hinge(
    spec: Any, body: Any, name: str, axis: float, robot: Robot, sim: MujocoSettings
) -> None:
    """Add a flipper's hinge, its end stops and its servo, which follows a velocity."""
    # The stops lie a little past the largest target, so that they do not push against the servo.
    limit = robot.angle_limit + _STOP_PLAY
    body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0.0, axis, 0.0],
        range=[-limit, limit],
        limited=True,
        armature=_ROTOR_INERTIA,
        solref_limit=[SAMPLE_PERIOD, 1.0],
    )
    # The servo's torque is proportional to the error of its velocity.
    servo = spec.add_actuator(
        name=name,
        target=name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        forcelimited=True,
        forcerange=[-robot.flipper_torque / 2, robot.flipper_torque / 2],
    )
    servo.gainprm[0], servo.biasprm[2] = _SERVO, -_SERVO


SCENERY = "scenery"
"""Name of the body of walls and posts."""
_HEIGHT = 2.5  # of walls and posts above the highest ground [m]
_WALL = 0.1  # of walls [m]
_BEFORE = 6.0  # length of the scenery before the first edge and past the last one [m]
_BETWEEN = 0.8, 2.0  # smallest and largest distance between posts [m]
_RADIUS = 0.05, 0.15  # smallest and largest radius of posts [m]
_BEHIND = 0.5  # largest distance of a post behind the line [m]
_COLOURS = {"walls": [0.8, 0.78, 0.72, 1.0], "posts": [0.45, 0.33, 0.22, 1.0]}


def add_scenery(spec: Any, profile: Profile, sim: MujocoSettings, rng: np.random.Generator) -> None:
    """Add walls or posts to a model; posts are placed at random by ``rng``."""
    if sim.scenery == "none":
        return
    body = spec.worldbody.add_body(name=SCENERY)
    ends = profile.start - _BEFORE, profile.end + _BEFORE
    low, high = (float(f(profile.points[:, 1])) for f in (np.min, np.max))
    half = (high + _HEIGHT - low) / 2 + 0.1
    # Scenery is seen and never touched.
    shared = {"contype": 0, "conaffinity": 0, "density": 0.0, "rgba": _COLOURS[sim.scenery]}
    for side in (1.0, -1.0):
        if sim.scenery == "walls":
            # As long as the ground, so that no ray passes by their ends
            length = (profile.end - profile.start) / 2 + LEVEL_GROUND
            middle = (profile.start + profile.end) / 2
            y = side * (sim.scenery_distance + _WALL / 2)
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=[middle, y, low - 0.1 + half],
                size=[length, _WALL / 2, half],
                **shared,
            )
            continue
        # Posts at random distances along this side
        x = ends[0]
        while (x := x + rng.uniform(*_BETWEEN)) < ends[1]:
            radius = rng.uniform(*_RADIUS)
            y = side * (sim.scenery_distance + radius + rng.uniform(0.0, _BEHIND))
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                pos=[x, y, low - 0.1 + half],
                size=[radius, half, 0.0],
                **shared,
            )
