"""``robot identify``: what a recorded drive tells of a robot's values."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from flipperctl.api import Robot
from flipperctl.ros.episode import Stamped, write_bag
from flipperctl.ros.estimates import (
    GRAVITY,
    Motion,
    actuator_delay,
    flipper_speed,
    flipper_torque,
    friction,
    track_speed,
)
from flipperctl.ros.messages import Messages
from tests.cli.call import call
from tests.ros.driving import state
from tests.ros.recorder import recording

TIME = np.arange(0, 8, 0.02)
NOISE = 0.003
SPEED, DELAY, BELTS = 0.4, 0.12, 0.25


def still(**others):
    """A robot that stands on level ground for 8 s."""
    ones = np.ones(len(TIME))
    values = {"angles": np.zeros((len(TIME), 2)), "pitch": 0 * ones, "belts": 0 * ones}
    values |= {"way": np.column_stack([0 * ones, 0.1 * ones]), "commands": np.empty((0, 3))}
    return Motion(time=TIME, **(values | others))


def turned(begin):
    """The front pair turns up by 1 rad from ``begin`` on, and down again 4 s later."""
    up, down = (SPEED * np.clip(TIME - at, 0, 1 / SPEED) for at in (begin, begin + 4))
    return np.column_stack([up - down, 0 * TIME])


COMMANDS = np.array([[0, 0, 0], [1, 1, 0], [5, 0, 0]], float)


def test_turns_tell_the_flippers_speed_and_commands_their_delay():
    noise = np.random.default_rng(0).normal(0, NOISE, (len(TIME), 2))
    motion = still(angles=turned(1 + DELAY) + noise, commands=COMMANDS)
    speed, delay = flipper_speed(motion), actuator_delay(motion)
    assert speed.low < SPEED < speed.high < 1.05 * speed.low
    assert delay.low < DELAY < delay.high < DELAY + 0.1
    assert (speed.why, delay.why) == ("turns: 2", "commands: 2")


def test_what_a_robot_that_stands_does_not_tell_is_said_with_the_drive_that_would():
    told = flipper_speed(still()), actuator_delay(still()), track_speed(still())
    told += friction(still(), 0.003), flipper_torque(still(), Robot(), SPEED, math.inf)
    assert [estimate.interval() for estimate in told] == ["not told"] * 5
    drives = "turn each", "record the commands", "drive straight", "slide down a steep one", "press"
    for estimate, drive in zip(told, drives, strict=True):
        assert drive in estimate.why


def test_a_load_that_was_held_and_one_below_which_a_pair_stalled_bound_the_torque():
    # Both pairs 30° down carry 45 kg: 220.7 N on each tip 0.291 m ahead of its hinge, less 24.5 N
    # at half of it. Friction 0.3 may help by 66.2 N at the hinge's height, 0.268 m.
    down = np.full((len(TIME), 2), -math.radians(30))
    low = (220.73 * 0.29098 - 49.05 * 0.14549 - 0.3 * 220.73 * 0.268) * 0.97
    held = flipper_torque(still(angles=down), Robot(), SPEED, 0.3)
    assert (held.low, held.high) == (pytest.approx(low, rel=1e-3), math.inf)
    assert "robot.payload" in held.why
    # Level pairs that are told to go down and stay carry nothing: 0.336 m, and friction hinders.
    high = (220.73 * 0.336 - 49.05 * 0.168 + 0.3 * 220.73 * 0.1) * 1.03
    commands = np.array([[0.0, -1.0, -1.0]])
    stalled = flipper_torque(still(commands=commands), Robot(), SPEED, 0.3)
    assert (stalled.low, stalled.high) == (0, pytest.approx(high, rel=1e-3))


@pytest.mark.parametrize("slides", [True, False])
def test_a_slide_tells_the_friction_and_a_slope_that_held_a_bound(slides):
    slope, value = 0.6, 0.5
    acceleration = GRAVITY * (math.sin(slope) - value * math.cos(slope)) if slides else 0.0
    along = BELTS * np.minimum(TIME, 2.0) + 0.5 * acceleration * np.clip(TIME - 2, 0, 0.8) ** 2
    way = np.column_stack([along * math.cos(slope), -along * math.sin(slope)])
    # At the foot the robot lies a little flatter, which is not the slope that it slid down
    pitch = np.interp(TIME, [2.8, 3.1], [-slope, 0.02 * slides - slope])
    belts = np.where(TIME < 2, BELTS, 0.0)
    noise = np.random.default_rng(0).normal(0, 0.0005, (len(TIME), 2))
    told = friction(still(way=way + noise, belts=belts, pitch=pitch), 0.003)
    if slides:
        assert told.low < value < told.high < told.low + 0.05
    else:
        assert (told.low, told.high) == (pytest.approx(math.tan(slope), rel=0.02), math.inf)
        assert "never slid, held on a slope of 34°" in told.why
    blind = replace(still(way=way, pitch=pitch), belts=np.full(len(TIME), math.nan))
    assert friction(blind, 0.003).interval() == "not told"


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Front flippers that turn up and down, on a robot that drives ahead after 3 s."""
    folder, make = tmp_path_factory.mktemp("bags"), Messages()
    with recording(folder / "bag", make.devices) as recorder:
        for time, (front, rear) in zip(TIME.tolist(), turned(1 + DELAY), strict=True):
            now, ran = 1e9 + time, max(0.0, time - 3)
            here = replace(state(0), position=np.array([BELTS * ran, 0.1]), time=time)
            recorder.write("/odom", make.odometry(here), now)
            recorder.write("/imu/data", make.imu(time, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), now)
            recorder.write("/joint_states", make.joint_state(time, front, rear), now)
            recorder.write("/belt_speed", make.number(BELTS if ran else 0.0), now)
            # The command has the names of the joints, but measures none
            target = COMMANDS[np.searchsorted(COMMANDS[:, 0], time + 1e-9) - 1, 1]
            recorder.write("/joint_command", make.joint_state(time, target, 0.0), now)
    return folder / "bag"


def test_a_bag_becomes_a_robots_file(bag, tmp_path):
    words = "chassis_mass: 20\nflipper_speed: 1.0\ntrack_speed: 1.0\nactuator_delay: 0.2\n"
    (tmp_path / "mine.yaml").write_text(words)
    arguments = str(bag), "robot=mine.yaml", "--output", "new.yaml"
    done = call("robot", "identify", *arguments, "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    values = json.loads(done.out)["values"]
    true = {"flipper_speed": SPEED, "actuator_delay": DELAY, "track_speed": BELTS}
    for name, value in true.items():
        row = values[f"robot.{name}"]
        assert row["low"] <= value <= row["high"]
        assert row["value"] == pytest.approx(value, abs=0.01)
    assert values["sim.friction"]["high"] is None
    assert "slide" in values["sim.friction"]["why"]

    # The file has the values, and all else as it was
    done = call("inspect", "config", "robot=new.yaml", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    robot = json.loads(done.out)["robot"]
    assert robot["chassis_mass"] == 20
    for name, value in true.items():
        assert robot[name] == pytest.approx(value, abs=0.01)
    text = (tmp_path / "new.yaml").read_text()
    assert "flipper_torque: 200 # not told: never held a load" in text
    assert "'randomise.robot.flipper_speed=[0." in text

    # People read the same, and no other file is overwritten
    done = call("robot", "identify", *arguments, cwd=tmp_path)
    assert "press each pair down" in " ".join(done.out.split())
    done = call("robot", "identify", str(bag), "--output", "mine.yaml", cwd=tmp_path)
    assert done.code == 2
    assert "mine.yaml" in done.err


def test_a_bag_without_joints_is_refused(tmp_path):
    make = Messages()
    messages = [Stamped(t, "/imu/data", make.imu(t, (0.0,) * 3, (0.0,) * 3)) for t in (0.0, 0.1)]
    write_bag(tmp_path / "bag", messages)
    done = call("robot", "identify", "bag", cwd=tmp_path)
    assert done.code == 2
    assert "no JointState has the angles" in done.err
