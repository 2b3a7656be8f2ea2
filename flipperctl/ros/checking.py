"""Cross-checks of a recording: what its devices and poses say of one another.

In: an opened bag, its topics and transforms. Out: how far independent measurements differ
(``flipperctl.core.crosschecks``), the devices that these contradict, and the clouds that tell
nothing new. One pass reads the messages; no cloud is held in memory.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from flipperctl.api import FloatArray
from flipperctl.core import crosschecks
from flipperctl.core.crosschecks import Difference, Peak, compared
from flipperctl.errors import RequestError
from flipperctl.ros.reading import Pose, Transforms, messages, pose_of, seconds
from flipperctl.ros.topics import Names, Topics
from flipperctl.runtime.messages import NewestJoints

_PERIOD = 0.1
"""Time between two poses that are compared with other measurements [s]."""
_AVERAGED = 0.5
"""Time over which accelerations are averaged [s]."""
_OTHER_CLOCK = 2.0
"""Delay of all messages from which their stamps are of another clock [s]."""


@dataclass
class Checked:
    """What the cross-checks found."""

    topics: Topics
    """The devices without those that are not used."""
    differences: list[Difference] = field(default_factory=list)
    """The largest of each check."""
    remarks: list[str] = field(default_factory=list)
    begun: float = 0.0
    """The first stamp, from which times count [s]."""
    repeated: Collection[int] = ()
    """Numbers of the clouds that tell nothing new."""
    by_stamps: bool = False
    """Whether the time of the recording is another than that of the stamps, which then counts."""

    def require(self, path: Path) -> None:
        """Raise RequestError if stamps or poses are contradicted, on which all depends."""
        for difference in self.differences:
            if difference.verdict == "refused" and difference.check.name.startswith(
                ("stamps", "transforms")
            ):
                raise RequestError(f"{path}: {difference.sentence(self.begun)}")

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The rows of the table of checks."""
        return [difference.row(self.begun) for difference in self.differences]


class _Heard:
    """What the messages of a bag say, as lists."""

    def __init__(self, reader: Any, names: Names, topics: Topics) -> None:
        self.stamps: dict[str, list[tuple[float, float]]] = {}  # topic → time of receipt, stamp
        self.contents: list[int] = []  # digests of the clouds
        self.units: list[tuple[float, str, FloatArray, FloatArray, FloatArray]] = []
        """Stamp, frame, vertical, turn rates and acceleration of the inertial unit."""
        self.belts: list[tuple[float, float, Pose | None]] = []
        self.apart: list[tuple[float, float, str]] = []  # stamp, angle and names of two joints
        # One pass keeps numbers alone: a bag's clouds may not fit into memory.
        joints = NewestJoints(names.front, names.rear, names.scale)
        wanted = {topics.clouds, topics.attitude, topics.belts, *topics.joints} - {None}
        for topic, received, message in messages(reader, {str(name) for name in wanted}):
            stamp = received
            if hasattr(message, "header"):
                stamp = seconds(message.header.stamp)
                # Joints may come in parts, whose stamps are then the same.
                part = " of " + message.name[0] if topic in topics.joints and message.name else ""
                self.stamps.setdefault(topic + part, []).append((received, stamp))
            if topic == topics.clouds:
                self.contents.append(hash(bytes(message.data)))
            elif topic == topics.attitude:
                self.units.append((stamp, *_unit(message)))
            elif topic == topics.belts:
                twisted = hasattr(message, "twist")
                speed = float(message.twist.twist.linear.x if twisted else message.data)
                posed = message.pose.pose if twisted else None
                pose = pose_of(posed.position, posed.orientation) if posed else None
                self.belts.append((stamp, names.belt_scale * speed, pose))
            elif angles := joints.take(stamp, message.name, message.position):
                for pair, which in zip(
                    angles.offsets or (), (names.front, names.rear), strict=False
                ):
                    joined = " and ".join(name.lstrip("-") for name in which)
                    self.apart.append((stamp, max(pair) - min(pair), joined))


def _unit(message: Any) -> tuple[str, FloatArray, FloatArray, FloatArray]:
    """Return frame, vertical, rates and acceleration of an ``Imu``; NaN for what it tells not."""
    q, rates, a = message.orientation, message.angular_velocity, message.linear_acceleration
    x, y, z, w = q.x, q.y, q.z, q.w
    up = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    has_attitude = message.orientation_covariance[0] != -1 and 0.5 < math.hypot(x, y, z, w) < 1.5
    push = np.array([a.x, a.y, a.z])
    if message.linear_acceleration_covariance[0] == -1:
        push[:] = np.nan
    frame = message.header.frame_id.lstrip("/")
    return frame, up if has_attitude else up * np.nan, np.array([rates.x, rates.y, rates.z]), push


def tells(message: Any) -> bool:
    """Return whether an ``Imu`` says that it holds an orientation."""
    return bool(np.isfinite(_unit(message)[1]).all())


def examine(reader: Any, names: Names, transforms: Transforms, topics: Topics) -> Checked:
    """Compare what the devices of a bag say; ``topics``: those that are used."""
    heard = _Heard(reader, names, topics)
    stamps = {topic: np.array(rows) for topic, rows in heard.stamps.items()}  # (N, 2)
    times = stamps.get(topics.clouds, np.empty((0, 2)))[:, 1]
    posed, poses = _poses(transforms, names, times, heard)
    differences: list[Difference] = []

    # Stamps and links, each against itself and against the clock of the others.
    links, late = transforms.checked(names.fixed, names.base)
    differences += links
    delays = {f"transforms of {names.base}": delay for delay in late[-1:]}
    for topic, rows in stamps.items():
        peaks, delays[topic] = crosschecks.by_clock(*rows.T)
        differences += compared(topic, **peaks)
    usual = sorted(delays.values())[(len(delays) - 1) // 2] if delays else 0.0
    for source, delay in delays.items():
        differences += compared(source, stamps_others=Peak(abs(delay - usual)))

    # Devices against the poses and against each other.
    differences += _attitude(heard, topics, names, transforms)
    if topics.belts is not None and len(posed) > 1:
        turns = Rotation.from_quat([pose.turn for pose in poses]).as_matrix()
        belts = np.array([row[:2] for row in heard.belts])
        if topics.belts not in stamps and abs(usual) > _OTHER_CLOCK:
            belts[:, 0] -= usual  # they have no stamps
        places = np.array([pose.place for pose in poses])
        ways = crosschecks.by_way(belts[:, 0], belts[:, 1], posed, places, turns[:, :, 0])
        differences += compared(topics.belts, **ways)
    known = [row for row in heard.apart if math.isfinite(row[1])]
    if known:
        stamp, apart, which = max(known, key=lambda row: row[1])
        differences += compared(which, joints_pair=Peak(apart, stamp))

    # Clouds that say the same although the robot has moved
    repeated: list[int] = []
    if len(times) and len(posed) > 1:
        steps = np.linalg.norm(np.diff([pose.place for pose in poses], axis=0), axis=1)
        moved = np.interp(times, posed, np.append(0.0, np.cumsum(steps)))
        again, peak = crosschecks.repeats(heard.contents, moved)
        repeated = np.flatnonzero(again).tolist()
        differences += compared(topics.clouds, cloud_repeats=peak)

    # What is wrong, and by which clock times count
    largest = crosschecks.largest(differences)
    begun = min((float(rows[:, 1].min()) for rows in stamps.values()), default=0.0)
    checked = Checked(topics, largest, begun=begun, repeated=frozenset(repeated))
    _judge(checked)
    if abs(usual) > _OTHER_CLOCK:
        checked.by_stamps = True
        checked.remarks.append(
            f"the stamps are {usual:.4g} s behind the recording's clock, as a simulator's are "
            "(--use-sim-time records its clock): their clock counts"
        )
    return checked


def _pose(transforms: Transforms, frame: str, of: str, time: float) -> Pose | None:
    """Return a pose; None also if no transform tells it, which who needs the pose says."""
    try:
        return transforms.pose(frame, of, time)
    except RequestError:
        return None


def _poses(
    transforms: Transforms, names: Names, times: FloatArray, heard: _Heard
) -> tuple[FloatArray, list[Pose]]:
    """Return times and poses of the chassis, by transforms or else by the belts' odometry."""
    times = np.concatenate([times, [row[0] for row in (*heard.units, *heard.belts)]])
    chassis = ((time, _pose(transforms, names.fixed, names.base, time)) for time in _spread(times))
    known = [(time, pose) for time, pose in chassis if pose is not None]
    if not known:
        # Without transforms, the pose in the odometry of the belts, if it has one
        by_period = {
            round(time / _PERIOD): (time, p) for time, _, p in heard.belts if p is not None
        }
        known = sorted(by_period.values(), key=lambda timed_pose: timed_pose[0])
    return np.array([time for time, _ in known]), [pose for _, pose in known]


def _spread(times: FloatArray) -> list[float]:
    """Return times of these, at least a period apart, in their order [s]."""
    times = np.sort(times[np.isfinite(times)])
    _, first = np.unique(np.floor(times / _PERIOD), return_index=True)
    return [float(time) for time in times[first]]


def _attitude(
    heard: _Heard, topics: Topics, names: Names, transforms: Transforms
) -> list[Difference]:
    """Compare the attitudes with poses, gravity and turn rates."""
    if topics.attitude is None:
        return []
    if not heard.units:
        return compared(topics.attitude, attitude_absent=Peak(1.0))
    times = np.array([row[0] for row in heard.units])
    ups, rates, pushes = (np.array([row[i] for row in heard.units]) for i in (2, 3, 4))
    # Tilts against the turn rates, message by message
    changes, by_rates = crosschecks.Tilts(), Peak(0.0)
    for time, up, rate in zip(times.tolist(), ups.tolist(), rates.tolist(), strict=True):
        size = changes.add(time, up, rate).get("attitude_rates", 0.0)
        by_rates = max(by_rates, Peak(size, time))

    # Accelerations shake: gravity is compared with their means.
    parts = np.floor((times - times[0]) / _AVERAGED)
    groups = [parts == part for part in np.unique(parts)]
    middle = np.array([times[mask].mean() for mask in groups])
    up, push = (np.array([rows[mask].mean(axis=0) for mask in groups]) for rows in (ups, pushes))
    peaks = {
        "attitude_absent": Peak(1 - float(np.mean(np.isfinite(ups).all(axis=1)))),
        "attitude_rates": by_rates,
        "attitude_gravity": crosschecks.by_gravity(middle, up, push),
        "attitude_return": _returns(times, ups),
    }

    # Against the poses, the verticals in the fixed frame, where the unit's place is known
    wanted = set(_spread(times))
    sampled = [
        (time, mount.directions(vertical[None])[0], Rotation.from_quat(pose.turn).as_matrix())
        for time, frame, vertical, *_ in heard.units
        if time in wanted
        and (pose := _pose(transforms, names.fixed, names.base, time))
        and (mount := _pose(transforms, names.base, frame, time))
    ]
    if sampled:
        peaks |= crosschecks.by_poses(*map(np.array, zip(*sampled, strict=True)))
    return compared(topics.attitude, **peaks)


def _returns(times: FloatArray, ups: FloatArray) -> Peak | None:
    """Return the jumps to and fro of the vertical; lengths of unit vectors are about angles."""
    known = np.isfinite(ups).all(axis=1)
    level = np.tile([0.0, 0.0, 0.0, 1.0], (int(known.sum()), 1))
    return crosschecks.by_steps(times[known], ups[known], level).get("transforms_return")


def _judge(checked: Checked) -> None:
    """Leave out the devices that are contradicted, and say so."""
    topics = checked.topics
    for difference in checked.differences:
        device, sentence = (
            difference.check.name.partition("_")[0],
            difference.sentence(checked.begun),
        )
        if difference.verdict == "ok":
            continue
        if difference.verdict == "refused" and device in ("attitude", "belts"):
            sentence += "; the device is not used"
            absent: dict[str, Any] = {device: None}
            topics = replace(topics, **absent)
        checked.remarks.append(sentence)
    checked.topics = topics
