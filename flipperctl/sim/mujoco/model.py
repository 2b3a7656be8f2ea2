"""MuJoCo's model of the scene: the ground's boxes and the robot with its tracks and flippers.

In: boxes, the robot and the engine's settings. Out: a compiled model, and the velocities and sides
of its belts. Frames: x forward, y to the left, z up.

A track is a box between two capsules that lie across it. Its belt is MuJoCo's ``surfacevel``: an
angular velocity about each part's own centre, of which contacts use the tangential part. That is
the belt's speed along the whole outline: on a capsule because it is round, on the box because its
two faces have the same distance from the centre everywhere. Cylinders as ends would stall at
edges, where MuJoCo gives them a horizontal normal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from flipperctl.api import SAMPLE_PERIOD, FloatArray, Robot
from flipperctl.sim.mujoco.ground import Box
from flipperctl.sim.mujoco.settings import MujocoSettings

LARGEST_PICTURE = 1920, 1080
"""Width and height of the largest picture [pixels]."""

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
"""Stiffness of friction relative to that of contacts, so that a held robot does not creep [-]."""
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
    spec.compiler.degree = False
    option = spec.option
    option.timestep = sim.substep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = _SLIP
    # Gravity is tilted instead of the ground, which is equivalent and keeps boxes upright.
    slope = sim.lateral_slope
    option.gravity = [0.0, -sim.gravity * math.sin(slope), -sim.gravity * math.cos(slope)]
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # divergence must be seen
    _set_looks(spec)
    for box in ground:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=box.centre,
            size=box.half,
            quat=[math.cos(box.tilt / 2), 0.0, -math.sin(box.tilt / 2), 0.0],
            contype=0,
            conaffinity=1,
            rgba=[0.62, 0.57, 0.5, 1.0],
            **_surface(sim),
        )
    _add_robot(spec, robot, sim)
    return spec


def _set_looks(spec: Any) -> None:
    """Set sizes, light and sky of pictures."""
    spec.visual.global_.offwidth, spec.visual.global_.offheight = LARGEST_PICTURE
    spec.visual.map.znear = 5e-4  # of the scene's extent of some 40 m, for the robot's cameras
    spec.visual.quality.shadowsize, spec.visual.quality.offsamples = 1024, 0  # drawn in software
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.5, 0.5, 0.5]
    spec.worldbody.add_light(
        pos=[0.0, 0.0, 6.0],
        dir=[0.3, 0.4, -1.0],
        diffuse=[0.5, 0.5, 0.5],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        castshadow=True,
    )
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.75, 0.85, 0.95],
        rgb2=[0.95, 0.95, 0.95],
        width=64,
        height=384,
    )


def _surface(sim: MujocoSettings) -> dict[str, Any]:
    return {"friction": [sim.friction, 0.0, 0.0], "condim": 3, **_CONTACT}


def _add_robot(spec: Any, robot: Robot, sim: MujocoSettings) -> None:
    half, width = robot.hinge_offset, sim.track_width
    chassis = spec.worldbody.add_body(name="chassis")
    chassis.add_freejoint(name="chassis")
    outer = sim.flipper_offset + width / 2
    size = robot.chassis_length, 2 * outer, 2 * robot.track_radius
    _set_inertia(chassis, mass=robot.chassis_mass, size=size, centre=0.0)
    if robot.payload:
        _add_load(chassis, robot)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        inner = sim.main_track_offset - width / 2
        middle = sign * sim.main_track_offset
        _add_board(chassis, f"main_{side}", (-half, half), middle, robot, sim)
        for end, x in (("front", half), ("rear", -half)):
            # One drum for the ends of main track and flipper, which turn about the same axle.
            y, half_width = sign * (inner + outer) / 2, (outer - inner) / 2
            _add_end(chassis, f"{end}_drum_{side}", (x, y), half_width, robot, sim)
    _add_cameras(chassis, robot, sim)
    # In the order that ``Model`` states
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for end, ahead in (("front", 1.0), ("rear", -1.0)):
            flipper = chassis.add_body(
                name=f"{end}_{side}", pos=[ahead * half, sign * sim.flipper_offset, 0.0]
            )
            reach = ahead * robot.flipper_axle
            size = robot.flipper_length, width, 2 * robot.track_radius
            _set_inertia(flipper, mass=robot.flipper_mass / 2, size=size, centre=reach / 2)
            _add_board(flipper, f"{end}_board_{side}", (0.0, reach), 0.0, robot, sim)
            _add_end(flipper, f"{end}_tip_{side}", (reach, 0.0), width / 2, robot, sim)
            _add_hinge(spec, flipper, f"{end}_{side}", -ahead, robot, sim)


def _add_cameras(chassis: Any, robot: Robot, sim: MujocoSettings) -> None:
    """Add the cameras above the hinges; one looks along its negative z axis, its y axis is up."""
    cos, sin = math.cos(sim.camera_tilt), math.sin(sim.camera_tilt)
    for name, ahead in (("front", 1.0), ("rear", -1.0)):
        axes = np.array([[0.0, -ahead, 0.0], [ahead * sin, 0.0, cos], [-ahead * cos, 0.0, sin]])
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, axes.T.ravel())
        place = [ahead * robot.hinge_offset, 0.0, sim.camera_height]
        chassis.add_camera(name=name, pos=place, quat=quat, fovy=math.degrees(sim.camera_angle))


def _set_inertia(
    body: Any, *, mass: float, size: tuple[float, float, float], centre: float
) -> None:
    """Set the mass [kg] and the inertia of a box around x = ``centre`` [m].

    ``size``: length, width and height [m]. In the side plane, the inertia is that of the planar
    engine's capsule.
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
        rgba=[0.2, 0.24, 0.28, 1.0],
        **_surface(sim),
    )


def _add_board(
    body: Any, name: str, along: tuple[float, float], y: float, robot: Robot, sim: MujocoSettings
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
        rgba=[0.85, 0.45, 0.1, 1.0],
        **_surface(sim),
    )


def _add_hinge(
    spec: Any, body: Any, name: str, axis: float, robot: Robot, sim: MujocoSettings
) -> None:
    """Add a flipper's hinge, its end stops and its servo, which follows a velocity."""
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
    servo = spec.add_actuator(
        name=name,
        target=name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        forcelimited=True,
        forcerange=[-robot.flipper_torque / 2, robot.flipper_torque / 2],
    )
    servo.gainprm[0], servo.biasprm[2] = _SERVO, -_SERVO
