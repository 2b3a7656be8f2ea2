"""A robot's node without its middleware: messages of ROS in, stamped commands and diagnoses out.

In: messages as rclpy, rosbags or anything else with the same fields has them; what the devices are
called and where they are, by ``Devices``; places of sensors, as tf knows them. Out: plain data that
a shell publishes. An operator takes over by a dead-man button, and a stop by hand lasts until it is
acknowledged.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from flipperctl.core import FloatArray
from flipperctl.core.lidar.body import Mount, mounting
from flipperctl.runtime.controller import Answer, FlipperController
from flipperctl.runtime.devices import Devices
from flipperctl.runtime.messages import Attitude, Cloud, JointAngles, Odometry
from flipperctl.runtime.point_cloud import PointTimes, read_cloud
from flipperctl.runtime.policy import OnnxPolicy
from flipperctl.runtime.states import Angles

BELTS = "belts"
"""Name of the belts among the joints of a command."""
Quaternion = tuple[float, float, float, float]
Level = Literal["ok", "warn", "error"]
Source = Literal["policy", "operator", "nobody"]
_LEVELS: dict[str, Level] = {"standby": "ok", "driving": "ok", "stopped": "error"}
_PATIENCE = 2.0
"""Time after which a device that is silent is told [s]."""


class Place(NamedTuple):
    """Where a sensor is on the chassis, as a transform of tf from its frame to ``frames.base``."""

    x: float
    y: float
    z: float
    turn: Quaternion
    """x, y, z and w."""


@dataclass(frozen=True)
class Command:
    """What the motors shall do from ``time`` on for ``valid_for``, and then no more."""

    time: float
    """By the clock of the node [s]."""
    valid_for: float
    """Time after which the belts stand and the flippers stay where they are [s]."""
    names: tuple[str, ...]
    """Joints that are commanded: those of the flippers, or none, and ``belts``."""
    angles: tuple[float, ...]
    """Of ``names``, as the robot counts them; NaN of the belts [1 / ``joints.scale`` rad]."""
    speeds: tuple[float, ...]
    """Of ``names``; NaN but of the belts: their largest speed ahead, 0: stand [m/s]."""
    drive: bool
    """Whether the belts may run."""
    source: Source
    """Who commands."""

    @property
    def flippers(self) -> tuple[float, ...]:
        """The angles of the flippers alone; empty if they get no command."""
        return self.angles[:-1]


@dataclass(frozen=True)
class Diagnosis:
    """How the controller is."""

    level: Level
    message: str
    """The reason of a fault, else the state."""
    values: dict[str, str]
    """``state``, ``fault``, ``commands`` (who does), and ``risk`` if there is one."""


class RobotNode:
    """Hands every message to a controller, and its answers on.

    Call ``step`` after each attitude and at least every 0.1 s, all from one thread. ``now`` is the
    clock of the stamps [s].
    """

    def __init__(
        self,
        policy: str | Path,
        devices: Devices | None = None,
        place_of: Callable[[str], Place | None] = lambda frame: None,
        *,
        shadow: bool = False,
        escape: bool = False,
        trusted: bool = False,
        log: Callable[[str], object] = lambda line: None,
        warn: Callable[[str], object] = lambda text: None,
    ) -> None:
        """``devices``: None for those of the policy's file, or nubot's.

        ``place_of`` returns where the frame of a sensor is, as tf knows it; None: not yet. ``log``
        receives the lines of the controller's log, ``warn`` what a builder should know, once each.
        For ``shadow``, ``escape`` and ``trusted`` see ``FlipperController``.

        Raises:
            MissingExtraError: onnxruntime is missing, or small_gicp for matched scans.
            PolicyError: the file is no exported policy.
        """
        self._policy, self._log, self._warn = policy, log, warn
        self._options = {"shadow": shadow, "escape": escape, "trusted": trusted}
        self._place_of = place_of
        if devices is None:
            devices = OnnxPolicy(policy).interface.devices or Devices()
        self.devices = devices
        # Until tf tells the place of the LiDAR, clouds are taken as measured in the chassis.
        at = devices.lidar
        self._mount = devices.mount or Mount(0.0, 0.0, math.pi / 2, at.near, at.margin)
        self._lidar: tuple[str, FloatArray, FloatArray] | None = None  # frame, turn and place
        self.controller = self._begun()

        # What has arrived since the last step
        self._times = PointTimes()
        self._joints = devices.newest_joints()
        self._cloud: Cloud | None = None
        self._angles: JointAngles | None = None
        self._belts: Odometry | None = None
        self._warned: set[str] = set()
        self._measured: JointAngles | None = None
        self._since = math.nan  # time of the first step [s]
        self._heard: set[str] = set()  # devices that have sent something
        self._axes: tuple[float, float, float] | None = None  # of an operator who drives
        self._goal: tuple[float, float] | None = None  # where the operator turns the flippers [rad]
        self._pressed: set[str] = set()  # emergency stops that are pressed now
        self._stopped = False
        self._then = self._joy_time = math.nan
        self.enabled = True
        """Whether the policy may command; the operator may at any time."""

    def _begun(self) -> FlipperController:
        devices = self.devices
        setup = devices.setup(self._mount)
        return FlipperController(self._policy, setup, devices.limits, self._log, **self._options)

    @property
    def speed(self) -> float:
        """Largest speed of the belts that is commanded [m/s]."""
        robot = self.controller.policy.interface.robot
        ours = self.devices.belts.speed
        return float(robot.get("track_speed", math.nan)) if ours is None else ours

    def acknowledge(self) -> str:
        """Let the robot go on after a stop that lasts; return what was done."""
        if self._pressed:
            return "the emergency stop is still pressed"
        self._stopped = False
        self.controller.acknowledge()
        return "acknowledged"

    def reset(self, since: float = -math.inf) -> None:
        """Begin anew on level ground, as after the robot was carried; by another clock, too.

        Messages stamped before ``since`` [s], which may still be on their way, are ignored.
        """
        self._cloud = self._angles = self._belts = self._measured = self._goal = None
        self._joints = self.devices.newest_joints()
        self.controller.reset(since)

    # What arrives

    def cloud(self, now: float, message: Any) -> None:
        """Take a ``PointCloud2``; one whose frame is not known goes on, and is refused."""
        frame, stamp = message.header.frame_id.lstrip("/"), _seconds(message.header.stamp)
        if self._lidar is not None and self._lidar[0] != frame:
            self._tell(f"clouds come in {self._lidar[0]} and in {frame}")
            return
        try:
            points, times = read_cloud(message)
        except ValueError as error:
            self._tell(str(error))
            return
        # Times of the points, whose unit and zero the clouds so far tell
        self._times.add(times, stamp, now)
        shifts, ages = self._times.shifts(times, stamp), None
        for text in self._times.remarks():
            self._tell(text)
        if shifts is not None:  # drivers stamp either end of a turn, we the last
            end = max(0.0, float(np.nanmax(shifts)))
            stamp, ages = stamp + end, end - shifts
        if self._knows(frame):
            assert self._lidar is not None
            _, turn, place = self._lidar
            points, frame = points @ turn.T + place, self.devices.frames.base
        self._cloud = Cloud(stamp, frame, points, ages)

    def _knows(self, frame: str) -> bool:
        """Return whether the place of the clouds' frame is known, which is fixed to the chassis.

        Clouds then come as a ``Mount`` measures them, so that rings stay rings.
        """
        if self._lidar is not None:
            return True
        base, fixed = self.devices.frames.base, self.devices.mount
        if fixed is not None:
            # The file tells the place: clouds in the chassis are moved there, others are there.
            turn = mounting(fixed.axis).T if frame == base else np.eye(3)
            place = -turn @ (fixed.x, 0.0, fixed.z) if frame == base else np.zeros(3)
            self._lidar = frame, turn, place
            return True
        if frame == base:
            return False
        mounted = self._place_of(frame)
        if mounted is None:
            self._tell(f"no transform from {frame} to {base} is known yet")
            return False
        turn = _matrix(mounted.turn)
        axis = math.atan2(turn[2, 2], turn[0, 2])  # about which it turns
        self._mount = replace(self._mount, x=mounted.x, z=mounted.z, axis=axis)
        self.controller = self._begun()
        back = self._mount.turn.T
        self._lidar = frame, back @ turn, back @ (0.0, mounted.y, 0.0)
        return True

    def imu(self, now: float, message: Any) -> Attitude:
        """Return the attitude of an ``Imu``, turned into the chassis if it is mounted otherwise.

        Hand it to ``step``: an attitude moves the pose on.
        """
        time, q = _seconds(message.header.stamp), message.orientation
        frame, base = message.header.frame_id.lstrip("/"), self.devices.frames.base
        w = math.nan if message.orientation_covariance[0] < 0 else q.w  # it tells no orientation
        rates, a = message.angular_velocity, message.linear_acceleration
        turn, rate = (q.x, q.y, q.z, w), np.array([rates.x, rates.y, rates.z])
        push = np.array([a.x, a.y, a.z]) if message.linear_acceleration_covariance[0] >= 0 else None
        # Another frame is turned, if its place is known; else it goes on, and is refused.
        place = self._place_of(frame) if frame != base else None
        if place is not None:
            x, y, z, w = place.turn
            turn, into, frame = _product(turn, (-x, -y, -z, w)), _matrix(place.turn), base
            rate, push = into @ rate, None if push is None else into @ push
        about = tuple(rate.tolist())
        return Attitude.from_imu(time, frame, turn, about, push if push is None else tuple(push))

    def joints(self, now: float, message: Any) -> None:
        """Take a ``JointState``, of all flippers or a part; other joints are not ours."""
        stamp = _seconds(message.header.stamp)
        self._heard |= {"joints"}
        angles = self._joints.take(stamp, message.name, message.position)
        self._angles = angles or self._angles
        self._measured = self._angles or self._measured

    def belts(self, now: float, message: Any) -> None:
        """Take the speed of the belts: an ``Odometry``, a ``TwistStamped``, or a ``Float64``.

        A ``Float64`` has no stamp, so it counts as measured ``now``.
        """
        if hasattr(message, "twist"):
            twist = getattr(message.twist, "twist", message.twist)
            now, speed = _seconds(message.header.stamp), twist.linear.x
        else:
            speed = message.data
        self._heard |= {"belts"}
        self._belts = self.devices.measured(Odometry(now, speed))

    def joy(self, now: float, message: Any) -> None:
        """Take a ``Joy``: the operator drives while the dead-man button is pressed."""
        pad = self.devices.operator
        buttons, axes = list(message.buttons), list(message.axes)
        # A button or an axis that the device lacks is never pressed or moved.
        self.press_stop(pad.stop < len(buttons) and bool(buttons[pad.stop]), source="joy")
        held = pad.deadman < len(buttons) and bool(buttons[pad.deadman])
        wanted = pad.belts, pad.front, pad.rear
        belts, front, rear = (float(axes[i]) if i < len(axes) else 0.0 for i in wanted)
        self._axes = (belts, front, rear) if held else None
        self._goal = self._goal if held else None
        self._joy_time = now

    def press_stop(self, pressed: bool, source: str = "stop") -> None:
        """Take an emergency stop by hand: the belts stand until ``acknowledge``.

        ``source``: which button, as several may be pressed at a time.
        """
        if pressed:
            self._pressed.add(source)
        else:
            self._pressed.discard(source)
        self._stopped = self._stopped or pressed

    # What goes out

    def step(
        self, now: float, attitude: Attitude | None = None
    ) -> tuple[Command | None, Diagnosis]:
        """Hand over what has arrived; return the command and the diagnosis.

        In shadow mode there is no command.
        """
        self._since = now if math.isnan(self._since) else self._since
        if now - self._since > _PATIENCE:
            self._tell_missing()
        if self._axes is not None and now - self._joy_time > self.devices.limits.valid_for:
            self._axes = self._goal = None  # the operator's radio is gone
        operator, shadow = self._axes is not None, self._options["shadow"]
        blocked = self._stopped or not (self.enabled or shadow)
        self.controller.manual = operator or blocked
        answer = self.controller.step(now, self._cloud, attitude, self._angles, self._belts)
        self._cloud = self._angles = self._belts = None
        elapsed, self._then = now - self._then, now
        source: Source = "operator" if operator else "policy"
        if self._stopped or (source == "policy" and blocked):
            source = "nobody"
        diagnosis = self._diagnosis(answer, source)
        if shadow:
            return None, diagnosis
        # Who commands: the operator, the policy, or nobody, for whom the belts stand.
        targets, speed = answer.targets, self.speed if answer.drive else 0.0
        if source == "operator":
            targets, speed = self._by_hand(elapsed)
        elif source == "nobody":
            targets, speed = None, 0.0
        return self._command(now, targets, speed, source), diagnosis

    def _tell_missing(self) -> None:
        """Tell of devices that should have sent something by now."""
        topics, missing = self.devices.topics, self._joints.missing
        if "joints" in self._heard and missing:
            self._tell(f"{topics.joints} tells no angle of the joints {', '.join(missing)}")
        if "belts" not in self._heard:
            self._tell(
                f"no speed of the belts has come on {topics.belts}: the policy decides as if they "
                "drove ahead all the time"
            )

    def _by_hand(self, elapsed: float) -> tuple[tuple[float, float] | None, float]:
        """Return where the operator turns the flippers, and how fast the belts shall run."""
        assert self._axes is not None
        belts, *turns = self._axes
        measured, robot = self._measured, self.controller.policy.interface.robot
        if measured is None:
            return None, belts * self.speed
        # Flippers go on from where they are, no faster than in the training.
        most = float(robot.get("flipper_speed", 0.0)) * (elapsed if 0 < elapsed < 1 else 0.0)
        signs = self.devices.signs
        now = self._goal or (measured.front, measured.rear)
        front, rear = (
            angle + sign * most * axis
            for angle, sign, axis in zip(now, (signs.front, signs.rear), turns, strict=True)
        )
        self._goal = front, rear
        return self._goal, belts * self.speed

    def _command(self, now: float, targets: Angles | None, speed: float, source: Source) -> Command:
        """Return a command in the names and units of the robot."""
        joints, names, angles = self.devices.joints, [], []
        half = len(targets := targets or ()) // 2
        for which, ends in ((joints.front, targets[:half]), (joints.rear, targets[half:])):
            # The joints of a pair have one target in common.
            for name, angle in zip(which, itertools.cycle(ends), strict=False):
                names.append(name.lstrip("-"))
                angles.append((-angle if name.startswith("-") else angle) / joints.scale)
        speeds = [math.nan] * len(names)
        return Command(
            time=now,
            valid_for=self.devices.limits.valid_for,
            names=(*names, BELTS),
            angles=(*angles, math.nan),
            speeds=(*speeds, speed),
            drive=speed != 0,
            source=source,
        )

    def _diagnosis(self, answer: Answer, source: Source) -> Diagnosis:
        values = {"state": answer.state, "fault": answer.fault, "commands": source}
        if answer.risk is not None:
            values["risk"] = f"{answer.risk:.2f}"
        if self._stopped:
            values["fault"] = "stop_by_hand"
            return Diagnosis("error", "stopped by hand; it goes on when acknowledged", values)
        if source == "nobody" and not answer.fault:
            return Diagnosis("ok", "the policy is not enabled", values)
        level = _LEVELS.get(answer.state, "warn")
        return Diagnosis(level, answer.reason or answer.state, values)

    def _tell(self, text: str) -> None:
        if text not in self._warned:
            self._warned.add(text)
            self._warn(text)


def _seconds(stamp: Any) -> float:
    """Return a stamp as one number [s]; NaN without a stamp, which the controller refuses."""
    return float(stamp.sec + 1e-9 * stamp.nanosec) or math.nan


def _matrix(q: Quaternion) -> FloatArray:
    """Return the rotation matrix of a quaternion, (3, 3)."""
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the rotation b, then a."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )
