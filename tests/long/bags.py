"""Recordings of a random drive, one device of each changed at random: is each kind reported?

``python -m tests.long.bags --count 300 --seed 1``: a drive over a bump with random speeds, angles,
rates, noise, delays and mounting is written as a bag, as it is (nothing may be reported) and with a
change of a random size at a random time (its kind must be).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from flipperctl.ros.checking import examine
from flipperctl.ros.episode import Stamped, write_bag
from flipperctl.ros.messages import Messages
from flipperctl.ros.reading import opened, read_transforms
from flipperctl.ros.topics import Names, found_devices

SECONDS = 14.0
Rng = np.random.Generator
IMU, ODOM, JOINTS, POINTS, TF = "/imu/data", "/odom", "/joint_states", "/points", "/tf"


@dataclass
class Row:
    """A message before it is written."""

    received: float
    topic: str
    stamp: float
    values: dict[str, Any]


def drive(rng: Rng) -> list[Row]:
    """Return what the devices of a robot measure that drives over a bump and turns a little."""
    speed, tilt = rng.uniform(0.15, 0.5), rng.uniform(0.25, 0.6)
    wave, begin, heading = rng.uniform(4, 8), rng.uniform(1.5, 4), rng.uniform(-3, 3)
    mount = Rotation.from_rotvec(rng.uniform(-1, 1, 3) * rng.uniform(0, 1.5))
    noise = rng.uniform(0, 0.01)

    def turn(time: Any) -> Rotation:
        phase = np.clip((time - begin) / wave, 0, 1)
        pitch, roll = -tilt * np.sin(2 * np.pi * phase), 0.1 * np.sin(0.7 * time)
        angles = np.array([heading + 0.1 * np.sin(0.3 * time), pitch, roll])
        return Rotation.from_euler("ZYX", angles.T)

    fine = np.arange(0, SECONDS, 0.01)
    ways = np.cumsum(speed * 0.01 * turn(fine).as_matrix()[:, :, 0], axis=0)

    def place(time: float) -> np.ndarray:
        return np.array([np.interp(time, fine, axis) for axis in ways.T])

    rows = []
    rates = {IMU: (30, 80), ODOM: (15, 30), JOINTS: (15, 30), POINTS: (5, 10), TF: (20, 40)}
    for topic, (least, most) in rates.items():
        period, delay, arrived = 1 / rng.uniform(least, most), rng.uniform(0, 0.05), 0.0
        for time in np.arange(rng.uniform(0, 0.2), SECONDS - 0.1, period).tolist():
            now = turn(time)
            values: dict[str, Any] = {"place": place(time) + noise / 3 * rng.normal(size=3)}
            values["turn"] = now * Rotation.from_rotvec(noise * rng.normal(size=3))
            if topic == IMU:
                unit = values["turn"] * mount
                rate = mount.inv().apply((now.inv() * turn(time + 1e-4)).as_rotvec() / 1e-4)
                gravity = (now * mount).inv().apply((0, 0, 9.81))
                values |= {"turn": unit, "rates": rate + noise * rng.normal(size=3)}
                values["gravity"] = gravity + 20 * noise * rng.normal(size=3)
            elif topic == ODOM:
                slip = 1 + 0.1 * np.sin(time)
                values["speed"] = np.array([slip * speed, 0, 0]) + noise * rng.normal(size=3)
            elif topic == JOINTS:
                front, rear = 0.8 * np.sin(0.6 * time), 0.5 * np.cos(0.4 * time)
                values["angles"] = np.array([front, front, rear, rear]) + noise * rng.normal(size=4)
            elif topic == POINTS:
                values["points"] = rng.uniform(-1, 1, (40, 3))
            arrived = max(arrived, time + delay + 0.02 * rng.exponential())
            rows.append(Row(arrived, topic, time, values))
    rows += [Row(0.0, "/tf_static", 0.0, {"place": np.zeros(3), "turn": mount, "child": "imu"})]
    for time in np.arange(0, SECONDS, 0.1).tolist():
        values = {"place": np.zeros(3), "turn": Rotation.identity(), "child": "odom"}
        rows.append(Row(time, TF, time, values))
    return rows


def of(rows: list[Row], topic: str, child: str | None = None) -> Iterator[Row]:
    """Yield the messages of a topic, or the transforms of a frame."""
    return (row for row in rows if row.topic == topic and row.values.get("child") == child)


def _turned(change: Callable[[Rotation], Rotation]) -> Callable[[list[Row], Rng], None]:
    def apply(rows: list[Row], rng: Rng) -> None:
        for row in of(rows, IMU):
            row.values["turn"] = change(row.values["turn"])

    return apply


def heading_alone(turn: Rotation) -> Rotation:
    """Return what a compass tells."""
    return Rotation.from_euler("z", turn.as_euler("ZYX")[0])


def turned_unit(rows: list[Row], rng: Rng) -> None:
    """The unit is mounted in another way than tf tells."""
    axis = rng.normal(size=3) * (1, 1, 0)
    by = Rotation.from_rotvec(rng.uniform(0.35, 2.5) * axis / np.linalg.norm(axis))
    for row in of(rows, IMU):
        row.values["turn"] = row.values["turn"] * by


def _scaled(topic: str, key: str, *ranges: tuple[float, float]) -> Callable[..., None]:
    def apply(rows: list[Row], rng: Rng) -> None:
        least, most = ranges[rng.integers(len(ranges))]
        factor = rng.uniform(least, most)
        for row in of(rows, topic):
            row.values[key] = factor * row.values[key]

    return apply


def speed_of_the_world(rows: list[Row], rng: Rng) -> None:
    """The speed is along the axes of the fixed frame, across which the robot drives."""
    angle = rng.choice([-1, 1]) * rng.uniform(1.3, 3.1)
    for row in of(rows, ODOM):
        row.values["speed"] = Rotation.from_euler("z", angle).apply(row.values["speed"])


def wrong_joint(rows: list[Row], rng: Rng) -> None:
    """A joint counts the other way, in degrees, from elsewhere, or stands still."""
    joint, kind = rng.integers(4), rng.integers(4)
    offset = rng.choice([-1, 1]) * rng.uniform(0.25, 2)
    for row in of(rows, JOINTS):
        angles = row.values["angles"]
        angles[joint] = (-angles[joint], 57.3 * angles[joint], angles[joint] + offset, 0.1)[kind]


def shifted_stamps(rows: list[Row], rng: Rng) -> None:
    """The stamps of a device are of another clock, or count in another unit."""
    topic = rng.choice([IMU, ODOM, JOINTS, POINTS])
    shift = rng.choice([-1, 1]) * 10 ** rng.uniform(0, 6)
    for row in of(rows, str(topic)):
        row.stamp += shift


def clock_set(rows: list[Row], rng: Rng) -> None:
    """The robot's clock is set at some time, back or on."""
    at, shift = rng.uniform(4, 9), rng.choice([-1, 1]) * rng.uniform(1.2, 60)
    for row in rows:
        row.stamp += shift * (row.stamp > at)


def second_publisher(rows: list[Row], rng: Rng) -> None:
    """Another node publishes the pose of the chassis, shifted, turned, or of a shorter way."""
    offset, factor = rng.normal(size=3), rng.uniform(0, 0.7)
    offset, angle = offset / np.linalg.norm(offset) * rng.uniform(0.2, 3), rng.uniform(0.3, 3)
    kind, rows_of = rng.integers(3), list(of(rows, TF))
    for row in rows_of[:: rng.integers(1, 4)]:
        values = dict(row.values)
        if kind == 1:
            values["turn"] = values["turn"] * Rotation.from_euler("z", angle)
        else:
            values["place"] = factor * values["place"] if kind else values["place"] + offset
            values["place"] = values["place"] + offset * (kind == 2)
        rows.append(replace(row, received=row.received + 0.003, values=values))
        rows[-1].stamp += rng.choice([0.0, 0.004])


def map_jump(rows: list[Row], rng: Rng) -> None:
    """The map is corrected at some time."""
    at, jump = rng.uniform(3, 10), rng.normal(size=3)
    jump *= rng.uniform(0.25, 3) / np.linalg.norm(jump)
    for row in of(rows, TF, "odom"):
        row.values["place"] = row.values["place"] + jump * (row.stamp > at)


_FLIP = Rotation.from_euler("x", np.pi)
ATTITUDE = {"attitude"}
KINDS: dict[str, tuple[Callable[[list[Row], Rng], None], set[str]]] = {
    "never set": (_turned(lambda turn: Rotation.identity()), ATTITUDE),
    "heading alone": (_turned(heading_alone), ATTITUDE),
    "z down": (_turned(lambda turn: _FLIP * turn), ATTITUDE),
    "NED": (_turned(lambda turn: _FLIP * turn * _FLIP), ATTITUDE),
    "inverse": (_turned(lambda turn: turn.inv()), ATTITUDE),
    "turned unit": (turned_unit, ATTITUDE),
    "belts' unit": (_scaled(ODOM, "speed", (-9, 0.5), (2.6, 9), (900, 1100)), {"belts"}),
    "world axes": (speed_of_the_world, {"belts"}),
    "wrong joint": (wrong_joint, {"joints"}),
    "shifted stamps": (shifted_stamps, {"stamps"}),
    "clock set": (clock_set, {"stamps"}),
    "second publisher": (second_publisher, {"transforms"}),
    "map jump": (map_jump, {"transforms"}),
}
"""Kind → its change, and the checks, by the part of their names before ``_``, that report it."""


def _messages(rows: list[Row]) -> Iterator[Stamped]:
    make = Messages()
    types = make.types.types

    def xyz(kind: str, values: Any) -> Any:
        x, y, z = (float(value) for value in values)
        return types[f"geometry_msgs/msg/{kind}"](x=x, y=y, z=z)

    def quaternion(turn: Rotation) -> Any:
        x, y, z, w = turn.as_quat().tolist()
        return types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)

    for row in rows:
        values, topic = row.values, row.topic
        if topic == IMU:
            message = make.imu(row.stamp, (0.0, 0.0, 0.0), values["rates"].tolist())
            message.orientation = quaternion(values["turn"])
            message.linear_acceleration = xyz("Vector3", values["gravity"])
            message.linear_acceleration_covariance = np.zeros(9)
            message.header.frame_id = "imu"
        elif topic == ODOM:
            pose = types["geometry_msgs/msg/Pose"](
                position=xyz("Point", values["place"]), orientation=quaternion(values["turn"])
            )
            twist = types["geometry_msgs/msg/Twist"](
                linear=xyz("Vector3", values["speed"]), angular=xyz("Vector3", (0, 0, 0))
            )
            message = types["nav_msgs/msg/Odometry"](
                header=make.header(row.stamp, "odom"),
                child_frame_id="base_link",
                pose=types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
                twist=types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
            )
        elif topic == JOINTS:
            message = make.joint_state(row.stamp, 0.0, 0.0)
            message.position = values["angles"]
        elif topic == POINTS:
            message = make.cloud(row.stamp, "base_link", values["points"])
        else:
            child = values.get("child", "base_link")
            parent = {"odom": "map", "base_link": "odom", "imu": "base_link"}[child]
            place = types["geometry_msgs/msg/Transform"](
                translation=xyz("Vector3", values["place"]), rotation=quaternion(values["turn"])
            )
            header = make.header(row.stamp, parent)
            one = types["geometry_msgs/msg/TransformStamped"](header, child, place)
            message = types["tf2_msgs/msg/TFMessage"](transforms=[one])
        yield Stamped(row.received, topic, message)


def reported(rows: list[Row], folder: Path) -> dict[str, str]:
    """Return the checks of a recording that do not agree, with what they say."""
    write_bag(folder, list(_messages(rows)))
    names = Names(fixed="map")
    with opened(folder) as reader:
        topics = found_devices(folder, reader, names, [])
        checked = examine(reader, names, read_transforms(folder, reader), topics)
    wrong = (one for one in checked.differences if one.verdict != "ok")
    return {one.check.name: one.sentence(checked.begun) for one in wrong}


def trial(seed: int, kind: str | None) -> str:
    """Return what is wrong with what is reported of a drive with a change; empty if nothing is."""
    rng = np.random.default_rng([seed, 0 if kind is None else 1 + [*KINDS].index(kind)])
    rows = drive(rng)
    if kind is not None:
        KINDS[kind][0](rows, rng)
    with tempfile.TemporaryDirectory() as folder:
        wrong = reported(rows, Path(folder) / "bag")
    if kind is None:
        return "; ".join(wrong.values())
    named = {name.partition("_")[0] for name in wrong}
    return "" if named & KINDS[kind][1] else f"not reported; {wrong or 'nothing is'}"


def main() -> int:
    """Run trials of all kinds in turn, as many unchanged ones, and print what failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    runs, failed = Counter[str](), Counter[str]()
    for number in range(options.count):
        changed = [*KINDS][(number // 2) % len(KINDS)]
        kind = None if number % 2 else changed
        label = kind or "unchanged"
        runs[label] += 1
        if text := trial(options.seed * 100_000 + number, kind):
            failed[label] += 1
            print(f"{label}, number {number}: {text}", flush=True)
    for label, count in runs.items():
        print(f"{label}: {count - failed[label]} of {count} right")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
