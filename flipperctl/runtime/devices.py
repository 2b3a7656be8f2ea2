"""What a robot's devices are called, where they are and how they count: one file for every door.

In: a file of YAML or JSON, or the section ``devices`` of a robot's file. Out: names for whoever
reads messages, the setup of a controller, and settings of the simulated LiDAR. What a file leaves
out is as nubot has it. JSON needs no package; YAML is read by ruamel.yaml.
"""

from __future__ import annotations

import difflib
import json
import math
import typing
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal

from flipperctl.core.lidar.body import Mount
from flipperctl.errors import PolicyError, missing_extra
from flipperctl.runtime.messages import (
    CONVENTIONS,
    REP_103,
    JointAngles,
    Limits,
    NewestJoints,
    Odometry,
    RobotSetup,
    Signs,
)

SECTION = "devices"
"""Section of a robot's file, and the key of the command line."""


@dataclass(frozen=True)
class Topics:
    """Topics of the robot; relative ones are in the namespace of the node."""

    clouds: str = "points"
    """``PointCloud2`` of the LiDAR or the depth camera; several come merged."""
    imu: str = "imu/data"
    """``Imu`` with an orientation."""
    joints: str = "joint_states"
    """``JointState`` of the flippers, all or a part in a message."""
    belts: str = "belt_speed"
    """Speed of the belts, a ``Float64``, or an ``Odometry``, which has a stamp."""
    joint_command: str = "joint_command"
    """Out: ``JointState`` with a stamp, angles of the flippers and the speed of the belts."""
    flipper_command: str = "flipper_controller/commands"
    """Out: ``Float64MultiArray`` of the flippers' angles, as forward_command_controller takes."""
    belts_may_run: str = "belts_may_run"
    """Out: ``Bool``."""
    joy: str = "joy"
    """``Joy`` of an operator."""


@dataclass(frozen=True)
class Frames:
    """Frames of tf."""

    base: str = "base_link"
    """The chassis: x ahead, y to the left, z up, from the middle between the flippers' hinges."""
    fixed: str = "odom"
    """The ground at rest."""


@dataclass(frozen=True)
class FlipperJoints:
    """Joints of the flippers; a - before a name tells that the joint counts the other way."""

    front: tuple[str, ...] = ("front_left_flipper", "front_right_flipper")
    """Those of the front pair."""
    rear: tuple[str, ...] = ("rear_left_flipper", "rear_right_flipper")
    """Those of the rear pair."""
    signs: Literal["rep103", "flipperctl"] = "rep103"
    """rep103: a front flipper below and a rear one above the chassis are positive; flipperctl: both
    are when raised."""
    scale: float = 1.0
    """Angle of 1 in a message [rad]; 0.017453292519943295 for degrees."""


@dataclass(frozen=True)
class Belts:
    """Speed of the belts."""

    scale: float = 1.0
    """Speed ahead of 1 in a message [m/s]; negative if it counts backwards, 0.001 for mm/s."""
    speed: float | None = None
    """Largest speed that is commanded [m/s]; null: the policy's robot's."""


@dataclass(frozen=True)
class Lidar:
    """Place and errors of the LiDAR or the depth camera."""

    x: float | None = None
    """Place ahead of the origin of ``frames.base`` [m]; null: tf tells the place."""
    z: float | None = None
    """Height above it [m]; null, as ``x``."""
    axis: float | None = None
    """Elevation of the axis about which it turns [rad]; null, as ``x``."""
    near: float = 0.1
    """Radius of its blind zone [m]."""
    margin: float = 0.05
    """Points closer than this to the robot's own shape do not enter the map [m]."""
    range_bias: float = 0.02
    """Largest constant error of its distances [m]."""


@dataclass(frozen=True)
class Operator:
    """Buttons and axes of a ``Joy``, by their numbers."""

    deadman: int = 5
    """Button that takes over as long as it is pressed."""
    stop: int = 1
    """Button of an emergency stop, which lasts until it is acknowledged."""
    belts: int = 1
    """Axis of the belts, ahead positive."""
    front: int = 4
    """Axis of the front flippers, up positive."""
    rear: int = 7
    """Axis of the rear flippers, up positive."""


@dataclass(frozen=True)
class Devices:
    """Everything of a robot's devices that a policy's file does not state."""

    topics: Topics = field(default_factory=Topics)
    frames: Frames = field(default_factory=Frames)
    joints: FlipperJoints = field(default_factory=FlipperJoints)
    belts: Belts = field(default_factory=Belts)
    lidar: Lidar = field(default_factory=Lidar)
    operator: Operator = field(default_factory=Operator)
    chassis_width: float = 0.352
    """Width of the chassis between the flippers [m]."""
    overall_width: float = 0.712
    """Width over the outer sides of the flippers [m]."""
    tilt_error: float = 0.0031622776601683794
    """Standard deviation of the inertial unit's roll and pitch [rad]."""
    pose: Literal["belts", "matched"] = "belts"
    """How scans enter the map: by odometry, or corrected by matching (needs small_gicp)."""
    limits: Limits = field(default_factory=Limits)
    """What the controller takes for safe."""

    def __post_init__(self) -> None:
        """Refuse what no robot can have."""
        stated = [value is not None for value in (self.lidar.x, self.lidar.z, self.lidar.axis)]
        if any(stated) and not all(stated):
            raise PolicyError("lidar: x, z and axis are allowed together, or none of them")
        if not 0 < self.chassis_width < self.overall_width:
            raise PolicyError(
                f"overall_width is {self.overall_width:g}; more than chassis_width "
                f"({self.chassis_width:g} m) is allowed, since the flippers are beside the chassis"
            )
        names = [name.lstrip("-") for name in (*self.joints.front, *self.joints.rear)]
        if not (self.joints.front and self.joints.rear) or len({*names}) < len(names):
            raise PolicyError(f"joints: different names for both pairs are allowed, not {names}")
        if 0 in (self.joints.scale, self.belts.scale):
            raise PolicyError("scale is 0; another number is allowed")

    @property
    def mount(self) -> Mount | None:
        """The place of the LiDAR; None if tf tells it."""
        at = self.lidar
        if at.x is None or at.z is None or at.axis is None:
            return None
        return Mount(at.x, at.z, at.axis, at.near, at.margin)

    @property
    def signs(self) -> Signs:
        """The signs of the messages; attitudes are quaternions, whose signs are by REP-103."""
        angles = CONVENTIONS[self.joints.signs]
        return Signs(front=angles.front, rear=angles.rear, pitch=REP_103.pitch)

    def newest_joints(self) -> NewestJoints:
        """Return what makes angles of the pairs [rad] of the joints' messages."""
        return NewestJoints(self.joints.front, self.joints.rear, self.joints.scale)

    def measured(self, message: Any) -> Any:
        """Return a message in the robot's units, of ``flipperctl.runtime``, in SI units."""
        if isinstance(message, JointAngles):
            front, rear = (self.joints.scale * angle for angle in (message.front, message.rear))
            return replace(message, front=front, rear=rear)
        if isinstance(message, Odometry):
            return replace(message, speed=self.belts.scale * message.speed)
        return message

    def setup(self, mount: Mount) -> RobotSetup:
        """Return the setup of a controller whose clouds come as ``mount`` measures them."""
        return RobotSetup(
            signs=self.signs,
            cloud_frame=self.frames.base,
            attitude_frame=self.frames.base,
            mount=mount,
            chassis_width=self.chassis_width,
            overall_width=self.overall_width,
            pose=self.pose,
            range_bias=self.lidar.range_bias,
            tilt_error=self.tilt_error,
        )

    def perception(self) -> dict[str, Any]:
        """Return the settings of ``perception=lidar`` for a robot with these devices."""
        at = self.lidar
        place = {"mount_x": at.x, "mount_z": at.z, "mount_axis": at.axis}
        return {name: value for name, value in place.items() if value is not None} | {
            "near": at.near,
            "filter_margin": at.margin,
            "range_bias": at.range_bias,
            "chassis_width": self.chassis_width,
            "overall_width": self.overall_width,
            "pose": self.pose,
        }

    def to_json(self) -> dict[str, Any]:
        """Return the devices as types of JSON."""
        document: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return document


def read_devices(path: Path) -> Devices:
    """Return the devices of a file, which may be a robot's with a section ``devices``."""
    settings = _load(path)
    if not isinstance(settings, Mapping):
        raise PolicyError(f"{path}: settings of devices are allowed; known: {_names(Devices)}")
    known = {item.name for item in fields(Devices)}
    if SECTION not in settings and settings and not known & settings.keys():
        raise PolicyError(
            f"{path}: there is no section {SECTION!r}, and no key of one: {_names(Devices)}"
        )
    return devices_of(settings.get(SECTION, settings), str(path))


def robot_devices(path: Path) -> Devices | None:
    """Return the devices in a robot's file; None if it has none."""
    settings = _load(path)
    has = isinstance(settings, Mapping) and SECTION in settings
    return read_devices(path) if has else None


def devices_of(settings: object, where: str) -> Devices:
    """Return the devices of plain settings; ``where``: the file, for errors."""
    try:
        devices: Devices = _built(Devices, settings, "")
    except PolicyError as error:
        raise PolicyError(f"{where}: {error}") from error
    return devices


def _load(path: Path) -> object:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise PolicyError(f"{path} cannot be read: {reason}") from error
    # JSON is read without a package.
    try:
        return json.loads(text)
    except ValueError:
        pass
    try:
        from ruamel.yaml import YAML
        from ruamel.yaml.error import YAMLError
    except ImportError as error:
        raise missing_extra(f"{path}: JSON needs no package; YAML", "ruamel.yaml") from error
    try:
        return YAML(typ="safe", pure=True).load(text)
    except YAMLError as error:
        raise PolicyError(f"{path}: {' '.join(str(error).split())}") from error


def _names(kind: type[Any]) -> str:
    return ", ".join(item.name for item in fields(kind))


def _built(kind: type[Any], settings: object, where: str) -> Any:
    """Return a dataclass of a mapping that may leave fields out; ``where``: its key and a dot."""
    if not isinstance(settings, Mapping):
        raise PolicyError(
            f"{where.rstrip('.') or 'devices'} is {settings!r}; a mapping with some of "
            f"{_names(kind)} is allowed"
        )
    types, values = typing.get_type_hints(kind), {}
    for name, value in settings.items():
        if name not in types:
            near = difflib.get_close_matches(str(name), types, 1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise PolicyError(f"{where}{name}: there is no such key{hint}; known: {_names(kind)}")
        values[name] = _value(types[name], value, f"{where}{name}")
    return kind(**values)


def _value(kind: Any, value: Any, where: str) -> Any:
    """Return a value of an annotation's type."""
    if is_dataclass(kind):
        return _built(typing.cast(type[Any], kind), value, f"{where}.")
    choices, allowed = typing.get_args(kind), "text"
    if typing.get_origin(kind) is Literal:
        fits, allowed = value in choices, " or ".join(map(str, choices))
    elif typing.get_origin(kind) is tuple:
        fits = isinstance(value, list) and all(isinstance(name, str) and name for name in value)
        value, allowed = tuple(value) if fits else value, "a list of names"
    elif kind is str:
        fits = isinstance(value, str) and bool(value)
    elif kind is int:
        fits = isinstance(value, int) and not isinstance(value, bool) and value >= 0
        allowed = "a whole number, 0 or more,"
    else:  # a number, or none
        fits = isinstance(value, int | float) and not isinstance(value, bool)
        fits = (fits and math.isfinite(value)) or (value is None and type(None) in choices)
        allowed = "a finite number" + (" or null" if choices else "")
    if not fits:
        raise PolicyError(f"{where} is {value!r}; {allowed} is allowed")
    return value
