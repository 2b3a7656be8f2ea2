"""Recorded ground from bags, and from folders of clouds with poses."""

import json
import math
import sys

import numpy as np
import pytest

from flipperctl.api import Robot, RobotState
from flipperctl.config import resolver
from flipperctl.core.lidar.body import attitude, mounting
from flipperctl.errors import MissingExtraError, RequestError
from flipperctl.ros.episode import TYPES, Stamped, write_bag
from flipperctl.ros.ground import GROUND, convert
from flipperctl.ros.messages import LIDAR, Messages
from flipperctl.ros.reading import Pose, Transforms
from flipperctl.ros.topics import Names
from flipperctl.text.files import check_output
from tests.cli.call import call

YAW, PITCH, AXIS = 0.3, 0.1, math.pi / 4
MOUNT = np.array([0.25, 0.0, 0.4])
HEIGHT = 0.15
TIMES = np.arange(0, 10.1, 1.0)


def state(time):
    """The robot drives 3 m along its heading, its nose up."""
    x, y = (-2 + 0.3 * time) * np.array([math.cos(YAW), math.sin(YAW)])
    return RobotState(
        np.array([x, 0.3]), PITCH, 0, 0, np.zeros(2), 0, float(time), yaw=YAW, side=float(y)
    )


def ground():
    """A step across the heading at the origin, (P, 3) in world [m]."""
    ahead, left = np.meshgrid(np.arange(-3, 4, 0.05), np.arange(-0.6, 0.61, 0.04))
    ahead, left = ahead.ravel(), left.ravel()
    x = math.cos(YAW) * ahead - math.sin(YAW) * left
    y = math.sin(YAW) * ahead + math.cos(YAW) * left
    return np.column_stack([x, y, np.where(ahead > 0, HEIGHT, 0.0)])


def in_chassis(time):
    """The ground within 2.5 m of the robot, and a point of its own, in frame R."""
    here = state(time)
    place = np.array([here.position[0], here.side, here.position[1]])
    seen = (ground() - place) @ attitude(0, PITCH, YAW)
    return np.vstack([seen[np.linalg.norm(seen, axis=1) < 2.5], [[0.6, 0.1, 0.2]]])


def messages(shift=0.0):
    make = Messages()
    yield Stamped(0.0, "/tf_static", make.mount(MOUNT[0], MOUNT[2], AXIS))
    for time in np.arange(0, 10.1, 0.25):
        yield Stamped(float(time), "/tf", make.transforms(state(time)))
    for time in TIMES.tolist():
        points = (in_chassis(time) - MOUNT) @ mounting(AXIS)
        yield Stamped(time, "/points", make.cloud(time + shift, LIDAR, points))


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Half of each turn is 0.5 s older than its stamp, in which the robot drives 15 cm."""
    make = Messages()
    turning = [m for m in messages() if m.topic != "/points"]
    for time in TIMES[1:].tolist():
        old, new = ((in_chassis(t) - MOUNT) @ mounting(AXIS) for t in (time - 0.5, time))
        ages = np.repeat([0.5, 0.0], [len(old), len(new)])
        cloud = make.cloud(time, LIDAR, np.vstack([old, new]), ages)
        turning.append(Stamped(time, "/points", cloud))
    folder = tmp_path_factory.mktemp("bags") / "drive"
    write_bag(folder, turning)
    return folder


def check_step(found):
    """Check that the recorded ground is the step, with the line along the heading."""
    start, end = np.array(found["start"]), np.array(found["end"])
    assert math.atan2(*(end - start)[::-1]) == pytest.approx(YAW, abs=0.01)
    line = {"path": found["output"], "start": found["start"], "end": found["end"]}
    terrain = resolver.create("terrain", {"name": "profile_file", **line}, "terrain")
    x, z = terrain.generate(np.random.default_rng(0)).points.T
    edge = float(np.linalg.norm(start))
    assert z[(x > edge + 0.1) & (x < edge + 1)].mean() - z[0] == pytest.approx(HEIGHT, abs=0.003)
    assert z[x < edge - 0.1] == pytest.approx(z[0], abs=0.01)  # none of the robot's own points


def test_a_bag_becomes_the_ground_that_was_measured(bag, tmp_path):
    output = tmp_path / "ground.xyz"
    done = call("robot", "ground", str(bag), "--output", str(output), "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert (found["clouds"], found["clouds_without_pose"]) == (len(TIMES) - 1, 0)
    check_step(found)
    done = call("robot", "ground", str(bag / "drive.mcap"), "--output", "same.xyz", cwd=tmp_path)
    assert "terrain=profile_file terrain.path=same.xyz 'terrain.start=[" in done.out
    assert (tmp_path / "same.xyz").read_text() == output.read_text()
    check_output(output, GROUND)  # ground of before is replaced


@pytest.mark.parametrize("columns", [8, 12])
def test_a_folder_of_clouds_with_poses_is_read_as_well(tmp_path, columns):
    lines = []
    for index, time in enumerate(TIMES.tolist()):
        np.save(tmp_path / f"{index:03}.npy", in_chassis(time))
        here = state(time)
        turn = attitude(0, PITCH, YAW)
        place = [here.position[0], here.side, here.position[1]]
        if columns == 12:
            lines.append(np.column_stack([turn, place]).ravel())
        else:
            half = YAW / 2, -PITCH / 2
            (c, s), (d, t) = ((math.cos(a), math.sin(a)) for a in half)
            lines.append([time, *place, -s * t, c * t, s * d, c * d])  # yaw, then pitch about y
    np.savetxt(tmp_path / "poses.txt", lines)
    check_step(convert(tmp_path, tmp_path / "ground.xyz", Robot()))
    (tmp_path / "000.npy").unlink()
    with pytest.raises(RequestError, match=r"11 poses for 10 clouds"):
        convert(tmp_path, tmp_path / "ground.xyz", Robot())


@pytest.mark.parametrize(
    ("poses", "error"),
    [
        ("", r"poses.txt: it is empty"),
        ("0 0 0 0 0 0 0 0", r"poses.txt, pose 1: the quaternion .* must not be 0"),
        ("0 0 0 0 0 0 0 1", r"a.ply cannot be read: \w+"),
    ],
)
def test_a_damaged_folder_of_clouds_is_named(tmp_path, poses, error):
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0.5\n"
    )
    (tmp_path / "poses.txt").write_text(f"{poses}\n")
    with pytest.raises(RequestError, match=error):
        convert(tmp_path, tmp_path / "ground.xyz", Robot())
    assert not (tmp_path / "ground.xyz").exists()


@pytest.mark.parametrize(
    ("made", "frames", "error"),
    [
        (messages, Names(base="lidar2"), "no frame 'lidar2'.*base_link, base_stabilized, lidar"),
        (
            lambda: messages(shift=100.0),
            Names(),
            "stamps against those of the others: 100 s",
        ),
        (lambda: list(messages())[:5], Names(), r"topics: none; the bag has /tf \(tf2_msgs/TFMes"),
    ],
)
def test_a_bag_that_cannot_be_used_is_refused_with_the_reason(tmp_path, made, frames, error):
    write_bag(tmp_path / "bag", list(made()))
    with pytest.raises(RequestError, match=error):
        convert(tmp_path / "bag", tmp_path / "ground.xyz", Robot(), frames)


def test_what_is_no_bag_is_refused(bag, tmp_path, monkeypatch):
    (tmp_path / "text.mcap").write_text("no bag")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "r.mcap").touch()
    whole = (bag / "drive.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    for source, error in {
        "text.mcap": "text.mcap cannot be read as a bag",
        "cut.mcap": "cut.mcap cannot be read as a bag.*'mcap recover .*cut.mcap -o whole.mcap' me",
        "absent": "absent: there is no such file or folder",
        "folder": "folder: this folder has neither metadata.yaml, .* nor poses.txt.*; r.mcap in it",
    }.items():
        with pytest.raises(RequestError, match=error):
            convert(tmp_path / source, tmp_path / "ground.xyz", Robot())
    done = call("robot", "ground", str(bag), "--output", "ground.pcd", cwd=tmp_path)
    assert "recorded ground is a .xyz file" in done.err
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'flipperctl\[ros\]'"):
        convert(bag, tmp_path / "ground.xyz", Robot())


def test_transforms_are_interpolated_and_inverted():
    quarter = np.array([0, 0, math.sqrt(0.5), math.sqrt(0.5)])  # about z
    tree = Transforms()
    tree.add("odom", "base", 1.6, Pose.none())
    tree.add("odom", "base", 2.0, Pose(np.array([1.0, 0, 0]), -quarter))
    tree.add("base", "sensor", None, Pose(np.array([0.0, 0, 1.0]), quarter))
    middle = tree.pose("odom", "base", 1.8)
    assert middle.place.tolist() == [0.5, 0, 0]
    assert 2 * math.acos(middle.turn[3]) == pytest.approx(math.pi / 4)
    sensor = tree.pose("odom", "sensor", 2.0)
    assert sensor.apply(np.array([[1.0, 0, 0]]))[0] == pytest.approx([0, 0, 1])  # half a turn
    assert tree.pose("sensor", "odom", 2.0).apply(np.zeros((1, 3)))[0] == pytest.approx([1, 0, -1])
    assert tree.pose("odom", "base", 2.2).place[0] == 1
    assert tree.pose("odom", "base", 2.3) is None
    tree.add("odom", "base", 10.0, Pose.none())
    assert tree.pose("odom", "base", 5.0) is None  # a gap is not bridged


def chain(*links, time=None):
    """Transforms of frames, each a parent, a child and x of the child in it."""
    tree = Transforms()
    for parent, child, x in links:
        tree.add(parent, child, time, Pose(np.array([x, 0, 0]), Pose.none().turn))
    return tree


def test_of_several_parents_the_one_counts_that_leads_to_the_frame() -> None:
    tree = chain(("odom", "base", 1.0), ("/map", "/base", 2.0), ("mast", "base", 3.0), time=5.0)
    assert [tree.pose(f, "base", 5.0).place[0] for f in ("odom", "map", "/mast")] == [1, 2, 3]
    assert tree.remarks("odom", "base") == [
        "base has 3 parents, map and mast and odom: its poses are those in odom (--fixed-frame)"
    ]


def test_two_ways_between_frames_must_agree() -> None:
    links = [("map", "odom", 1.0), ("odom", "base", 2.0), ("map", "base", 3.0)]
    assert chain(*links).pose("map", "base", 0.0).place[0] == 3
    tree = chain(*links[:2], ("map", "base", 3.1))
    assert tree.pose("odom", "base", 0.0).place[0] == 2  # straight, not by map
    with pytest.raises(RequestError, match="'base' has two parents, 'map' and 'odom', by which"):
        tree.pose("map", "base", 0.0)


def test_two_odometries_of_one_frame_are_refused(tmp_path, monkeypatch):
    make, both = Messages(), ("/wheel/odom", "/odometry/filtered")
    told = [m for m in messages() if m.topic != "/tf"]
    for topic in both:
        monkeypatch.setitem(TYPES, topic, TYPES["/odom"])
        told += [Stamped(time, topic, make.odometry(state(time))) for time in TIMES.tolist()]
    write_bag(tmp_path / "bag", told)
    with pytest.raises(
        RequestError, match=r"come from /odometry/filtered and /wheel/odom, and from"
    ):
        convert(tmp_path / "bag", tmp_path / "ground.xyz", Robot())
    write_bag(tmp_path / "one", [m for m in told if m.topic != both[0]])
    check_step(convert(tmp_path / "one", tmp_path / "ground.xyz", Robot()))
