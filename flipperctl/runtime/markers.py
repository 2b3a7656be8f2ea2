"""What a robot's controller perceives and plans, as points and lines to draw.

In: a node, and the command whose flippers are drawn. Out: markers in the frame of the chassis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from flipperctl.core import FloatArray
from flipperctl.core.observation import edges
from flipperctl.runtime.devices import Devices
from flipperctl.runtime.node import Command, RobotNode

_SEEN, _UNSEEN, _PLAN = (0.1, 0.6, 0.2), (0.6, 0.6, 0.6), (0.9, 0.5, 0.1)  # colours


@dataclass(frozen=True)
class Marker:
    """Something to draw in ``frames.base``."""

    name: Literal["map", "heights", "unseen", "plan", "risk"]
    points: FloatArray
    """(P, 3) [m]; of ``plan``, pairs of ends of lines."""
    colour: tuple[float, float, float]
    text: str = ""


def markers_of(node: RobotNode, answer: Command | None = None) -> list[Marker]:
    """Return what the controller of a node perceives and plans, in ``frames.base``.

    ``answer``: the command whose flippers are drawn.
    """
    controller = node.controller
    interface, ground, pitch = controller.policy.interface, controller.ground, controller.pitch
    markers = [Marker("map", _level(controller.map_points, pitch), _UNSEEN)]
    if ground is not None and ground.heights is not None:
        # The mean height of each bin, and those in which nothing was seen
        ends = edges(interface.bins, interface.bin_width)
        x, z = (ends[1:] + ends[:-1]) / 2, ground.heights[: interface.bins]
        points = _level(np.column_stack([x, np.zeros_like(x), z]), pitch)
        seen = np.full(len(x), True) if ground.seen is None else ground.seen
        markers.append(Marker("heights", points[seen], _SEEN))
        markers.append(Marker("unseen", points[~seen], _UNSEEN))
    policy, robot = controller.policy, interface.robot
    if answer is not None and answer.flippers:
        markers.append(Marker("plan", _flippers(answer, node.devices, robot), _PLAN))
    if policy.risk is not None:
        text = f"risk {policy.risk:.2f}{' warning' if policy.warning else ''}"
        markers.append(Marker("risk", np.array([[0.0, 0.0, 0.6]]), _PLAN, text))
    return markers


def _flippers(answer: Command, devices: Devices, robot: Any) -> FloatArray:
    """Return both pairs at their targets as lines from hinge to tip, (4, 3) [m]."""
    half = robot["chassis_length"] / 2 - robot["track_radius"]
    length = robot["flipper_length"] - robot["track_radius"]
    signs, scale = devices.signs, devices.joints.scale
    lines: list[list[float]] = []
    firsts = (devices.joints.front[0], devices.joints.rear[0])
    angles: dict[str, float] = dict(zip(answer.names, answer.angles, strict=True))
    for name, sign, ahead in zip(firsts, (signs.front, signs.rear), (1, -1), strict=True):
        mirrored = -1 if name.startswith("-") else 1
        angle = mirrored * sign * scale * angles[name.lstrip("-")]
        tip = half + length * math.cos(angle), length * math.sin(angle)
        lines += [[ahead * half, 0.0, 0.0], [ahead * tip[0], 0.0, tip[1]]]
    return np.array(lines)


def _level(points: FloatArray, pitch: float) -> FloatArray:
    """Return level points, (P, 3), in the chassis, which is pitched nose up [m, rad]."""
    cos, sin = math.cos(pitch), math.sin(pitch)
    x, y, z = points.reshape(-1, 3).T
    return np.column_stack([cos * x + sin * z, y, cos * z - sin * x])
