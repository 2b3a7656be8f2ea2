"""The scene as files for other simulators: MJCF of robot and ground, URDF of each.

In: a world of ``sim=mujoco``. Out: texts in XML, from the same model that the engine simulates.

Signs: MJCF has the joints of the engine, positive above the chassis at both ends. URDF follows
REP-103, where every hinge turns about +y: the front flippers are positive below the chassis, the
rear flippers above it. The limits are the same, since the range is symmetric.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from flipperctl.api import FloatArray, Robot
from flipperctl.sim.mujoco.ground import Box
from flipperctl.sim.mujoco.model import specify
from flipperctl.sim.mujoco.shown import set_looks
from flipperctl.sim.mujoco.world import MujocoWorld

FLIPPERS = ("front_left", "front_right", "rear_left", "rear_right")
"""Flippers in the order of messages and files; a joint is called ``<flipper>_flipper``."""
_ROOT = "base_link"  # REP-105
_CHASSIS = "chassis"


def mjcf(world: MujocoWorld) -> str:
    """Return the scene at its start as MJCF; the keyframe ``start`` has the flippers' angles."""
    spec = specify(world.ground, world.robot, world.sim)
    set_looks(spec)
    # The specification has the chassis at the origin; the file begins where the episode does.
    pose = world.data.qpos.tolist()
    chassis = spec.body(_CHASSIS)
    chassis.pos, chassis.quat = pose[:3], pose[3:7]
    spec.modelname = "flipperctl"
    spec.add_key(name="start", qpos=pose)
    spec.compile()
    text: str = spec.to_xml()
    return text


def urdf(world: MujocoWorld) -> str:
    """Return the robot as URDF: a link for the chassis and one for each flipper.

    URDF has neither capsules nor belts: round ends are cylinders of the belts' width, and the
    belts' speed is left to the simulator that reads the file.
    """
    model, robot = world.model, world.robot
    root = ElementTree.Element("robot", name="flipperctl")
    _link(root, model, _CHASSIS, _ROOT)
    for name in FLIPPERS:
        _link(root, model, name, f"{name}_flipper_link")
        _joint(root, model, name, robot)
    return _text(root)


def ground_urdf(ground: Sequence[Box]) -> str:
    """Return the ground as URDF: one link of boxes in world, which Gazebo keeps in place."""
    root = ElementTree.Element("robot", name="ground")
    link = ElementTree.SubElement(root, "link", name="ground")
    for box in ground:
        shape = "box", {"size": _numbers(2 * half for half in box.half)}
        # Up towards +x is a turn about -y.
        _shape(link, box.centre, (0.0, -box.tilt, box.turn), shape)
    ElementTree.SubElement(ElementTree.SubElement(root, "gazebo"), "static").text = "true"
    return _text(root)


def _link(root: ElementTree.Element, model: Any, body: str, name: str) -> None:
    """Add a link with the mass, the inertia and the shapes of a body of the model."""
    link = ElementTree.SubElement(root, "link", name=name)
    body_model = model.body(body)
    # The inertia is a full tensor in the link's own axes, since a load turns the principal ones.
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_numbers(body_model.ipos), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=_numbers(body_model.mass))
    tensor = _tensor(body_model)
    moments = dict(zip(("ixx", "iyy", "izz"), map(_number, np.diag(tensor)), strict=True))
    products = {"ixy": tensor[0, 1], "ixz": tensor[0, 2], "iyz": tensor[1, 2]}
    others = {name: _number(value) if value else "0" for name, value in products.items()}
    ElementTree.SubElement(inertial, "inertia", moments | others)
    # URDF's cylinders stand along z, while the round ends of belts lie along y.
    for index in range(model.ngeom):
        geom = model.geom(index)
        if int(geom.bodyid[0]) != body_model.id:
            continue
        if int(geom.type[0]) == int(mujoco.mjtGeom.mjGEOM_BOX):
            _shape(link, geom.pos, (0.0, 0.0, 0.0), ("box", {"size": _numbers(2 * geom.size)}))
        else:
            radius, half, _ = geom.size.tolist()
            size = {"radius": _number(radius), "length": _number(2 * half)}
            _shape(link, geom.pos, (math.pi / 2, 0.0, 0.0), ("cylinder", size))


def _tensor(body: Any) -> FloatArray:
    """Return the inertia tensor of a body in its own axes, (3, 3) [kg m²]; a load may turn it."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, body.iquat)
    axes = turn.reshape(3, 3)
    tensor: FloatArray = axes @ np.diag(body.inertia) @ axes.T
    return tensor


def _joint(root: ElementTree.Element, model: Any, name: str, robot: Robot) -> None:
    joint = ElementTree.SubElement(root, "joint", name=f"{name}_flipper", type="revolute")
    ElementTree.SubElement(joint, "parent", link=_ROOT)
    ElementTree.SubElement(joint, "child", link=f"{name}_flipper_link")
    place = _numbers(model.body(name).pos)
    ElementTree.SubElement(joint, "origin", xyz=place, rpy="0 0 0")
    ElementTree.SubElement(joint, "axis", xyz="0 1 0")
    # A joint is one flipper, which has half of its pair's torque.
    limit = robot.angle_limit
    ElementTree.SubElement(
        joint,
        "limit",
        lower=_number(-limit),
        upper=_number(limit),
        effort=_number(robot.flipper_torque / 2),
        velocity=_number(robot.flipper_speed),
    )


def _shape(
    link: ElementTree.Element,
    place: Sequence[float],
    turn: tuple[float, float, float],
    shape: tuple[str, dict[str, str]],
) -> None:
    """Add a shape that is seen and that collides, at ``place`` [m], turned by ``turn`` [rad]."""
    for purpose in ("visual", "collision"):
        part = ElementTree.SubElement(link, purpose)
        ElementTree.SubElement(part, "origin", xyz=_numbers(place), rpy=_numbers(turn))
        ElementTree.SubElement(ElementTree.SubElement(part, "geometry"), shape[0], shape[1])


def _numbers(values: Any) -> str:
    return " ".join(map(_number, values))


def _number(value: float) -> str:
    return f"{float(value):.12g}"


def _text(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'
