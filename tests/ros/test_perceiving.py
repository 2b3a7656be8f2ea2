"""``robot check``: what a robot's own recording shows of its sensing."""

import dataclasses
import json
import math

import numpy as np
import pytest
from PIL import Image

from flipperctl.api import Robot
from flipperctl.core.lidar.messages import Pose
from flipperctl.errors import RequestError
from flipperctl.figures.perceived import faces
from flipperctl.ros.episode import Stamped, write_bag
from flipperctl.ros.messages import Messages
from flipperctl.ros.perceiving import drift, replay
from flipperctl.ros.recording import read_recording
from flipperctl.ros.topics import Names
from flipperctl.runtime.messages import REP_103
from flipperctl.sim.lidar import LidarSensor
from tests.cli.call import call
from tests.ros import driving as drive
from tests.ros.driving import EDGE, HEIGHT, SECONDS, SPEED, driving, points

CLOUDS = round(10 * SECONDS) + 1


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags") / "drive"
    write_bag(folder, list(driving()))
    return folder


def replayed(source, pose=None):
    return replay(source, LidarSensor(), Robot(), pose, Names())


def test_the_step_ahead_of_the_robot_is_perceived(bag):
    found = replayed(bag)
    summary = found.summary
    assert (summary["scans"], summary["refused"], summary["held"]) == (CLOUDS, {}, {})
    assert summary["pose"] == "belts"
    assert summary["topics"]["odometry"] == "/belt_speed"
    assert summary["decisions"] == len(found.instants) == 4  # at 0, 0.6 … 1.8 s
    last = found.instants[-1]
    assert (last.angles.front, last.angles.rear) == pytest.approx((drive.FRONT, drive.REAR))
    assert last.ground.heights[-1] == pytest.approx(HEIGHT - 0.1, abs=0.005)
    assert last.ground.heights[:8] == pytest.approx([-0.1] * 8, abs=0.005)
    (face,) = faces(last.ground.points, last.ground.filled)
    assert face[0, 0] == pytest.approx(EDGE - SPEED * last.time, abs=0.03)
    assert np.ptp(face[:, 1]) == pytest.approx(HEIGHT, abs=0.01)
    on_map = last.known[np.abs(last.known[:, 0]) < 0.5]
    assert on_map[:, 2] == pytest.approx(np.full(len(on_map), -0.1), abs=0.01)
    assert summary["drift"]["way"] == pytest.approx(SPEED * SECONDS)
    assert summary["drift"]["horizontal"] < 0.02


def test_the_command_writes_a_film_a_picture_and_the_numbers(bag, tmp_path):
    done = call("robot", "check", str(bag), "--output", "a.gif", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    summary = json.loads(done.out)
    assert 0.3 < summary["coverage"]["least"] <= summary["coverage"]["mean"] <= 1
    assert summary["bins"][0] == {"x": -1.05, "seen": 0.0, "deviation": None}
    assert summary["estimate_ms"]["p50"] <= summary["estimate_ms"]["p99"]
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == summary["decisions"]
    done = call("robot", "check", str(bag), "--output", "a.svg", "--at", "1.1", cwd=tmp_path)
    assert "odometry by belts and inertial unit" in done.out
    assert " 1.2 s -->" in (tmp_path / "a.svg").read_text()


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["--output", "a.avi"], "a film is a .gif or .mp4 file"),
        (["--at", "2"], "a picture needs --output FILE.png"),
        (["--output", "a.png"], "a picture needs --at SECONDS"),
        (["--output", "a.gif", "--at", "2"], "a picture ends in .png"),
        (["--output", "a.png", "--at", "500"], "--at 500: 0 to "),
        (["--base-frame", "base_lnk"], "there is no frame 'base_lnk' (did you mean 'base_link'"),
        (["--topic", "/poins"], "no PointCloud2 is on '/poins'"),
    ],
)
def test_a_wrong_request_is_one_error(bag, tmp_path, words, error):
    done = call("robot", "check", str(bag), *words, cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert error in done.err


def changed(topic, change):
    """The messages with those of a topic changed."""
    for one in driving():
        yield one._replace(message=change(one.message)) if one.topic == topic else one


def stamped(shift):
    def change(message):
        stamp = message.header.stamp
        sec = 0 if shift is None else stamp.sec + shift
        stamp = dataclasses.replace(stamp, sec=sec, nanosec=0 if shift is None else stamp.nanosec)
        return dataclasses.replace(message, header=dataclasses.replace(message.header, stamp=stamp))

    return change


def without_orientation(message):
    covariance = np.full(9, -1.0)
    return dataclasses.replace(message, orientation_covariance=covariance)


@pytest.mark.parametrize(
    ("messages", "error"),
    [
        (lambda: changed("/points", stamped(None)), "a cloud has no stamp"),
        (lambda: driving(clouds=False), "the PointCloud2 of one topic is needed"),
    ],
)
def test_a_bag_that_cannot_be_used_is_one_error(tmp_path, messages, error):
    write_bag(tmp_path / "bag", list(messages()))
    with pytest.raises(RequestError, match=error):
        replayed(tmp_path / "bag")


def test_a_recording_by_another_clock_than_its_stamps_goes_by_these(bag, tmp_path):
    """As a bag of a simulator without ``--use-sim-time``: nothing changes but a remark."""
    late = [m._replace(time=m.time + 60) for m in driving()]
    write_bag(tmp_path / "bag", late)
    summary, usual = replayed(tmp_path / "bag").summary, replayed(bag).summary
    for key in ("scans", "refused", "decisions", "held"):
        assert summary[key] == usual[key]
    assert summary["drift"] == pytest.approx(usual["drift"], abs=1e-6)
    assert summary["remarks"][0].startswith("the stamps are 60 s behind the recording's clock")


def test_scans_that_are_refused_are_counted_with_the_reason(tmp_path):
    def few(message):
        return dataclasses.replace(message, width=5, row_step=60, data=message.data[-60:])

    both = zip(driving(), changed("/points", few), strict=True)
    write_bag(tmp_path / "bag", [one if one.time <= 0.91 else other for one, other in both])
    summary = replayed(tmp_path / "bag").summary
    refused = summary["refused"]["cloud_points"]
    assert (summary["scans"], refused["count"]) == (10, CLOUDS - 10)
    assert "has 5 points that are finite, nearer than 1 km, not 0; 20 or more" in refused["reason"]
    assert summary["held"] == {"cloud_points": 1}  # at 1.8 s


def test_poses_of_the_bag_stand_in_for_an_inertial_unit_without_orientation(tmp_path):
    write_bag(tmp_path / "bag", list(changed("/imu/data", without_orientation)))
    summary = replayed(tmp_path / "bag").summary
    assert (summary["pose"], summary["drift"], summary["held"]) == ("true", None, {})
    assert "tells no orientation" in summary["remarks"][0]
    with pytest.raises(RequestError, match=r"perception\.pose=matched needs an Imu"):
        replayed(tmp_path / "bag", pose="matched")


def test_rings_of_a_tilted_lidar_stay_rings(bag):
    recording = read_recording(bag, Names())
    assert recording.axis == pytest.approx(drive.AXIS)
    cloud = next(s.messages["cloud"] for s in recording.steps() if "cloud" in s.messages)
    assert cloud.points == pytest.approx(points(0.0), abs=1e-5)


def test_an_inertial_unit_may_be_mounted_in_any_way(tmp_path):
    """One that is turned to the left by 90° sees the raised nose as a roll."""
    make, up = Messages(), 0.3

    def turned():
        yield from (m for m in driving() if m.topic != "/imu/data")
        half = math.sqrt(0.5)
        types = make.types.types
        place = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.1)
        turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=half, w=half)
        one = types["geometry_msgs/msg/TransformStamped"](
            header=make.header(0.0, "base_link"),
            child_frame_id="imu",
            transform=types["geometry_msgs/msg/Transform"](translation=place, rotation=turn),
        )
        yield Stamped(0.0, "/tf_static", types["tf2_msgs/msg/TFMessage"](transforms=[one]))
        # Its x axis is to the robot's left, so its y axis points back, and sinks.
        message = make.imu(0.0, (-up, 0.0, math.pi / 2), (0.0, 0.0, 0.4))
        header = make.header(0.0, "imu")
        yield Stamped(0.0, "/imu/data", dataclasses.replace(message, header=header))

    write_bag(tmp_path / "bag", list(turned()))
    recording = read_recording(tmp_path / "bag", Names())
    (told,) = [s.messages["attitude"] for s in recording.steps() if "attitude" in s.messages]
    assert (told.roll, REP_103.pitch * told.pitch) == pytest.approx((0.0, up), abs=1e-9)
    assert told.yaw_rate == pytest.approx(0.4 / math.cos(up))  # about the axis that leans back


def test_drift_is_the_difference_of_the_ways_since_their_starts():
    assert drift([]) is None
    # The second way begins elsewhere, and turned to the left by 90°.
    poses = [
        (Pose(0.9 * x, 0, 0.01 * x, 0, 0, 0.1 * x), Pose(5, 7 + x, 3, 0, 0, math.pi / 2))
        for x in (0.0, 1.0, 2.0)
    ]
    assert drift(poses) == pytest.approx(
        {"way": 2.0, "horizontal": 0.2, "share": 0.1, "height": 0.02, "heading": 0.2}
    )
