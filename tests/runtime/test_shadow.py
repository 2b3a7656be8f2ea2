"""Shadow mode on messages: a log for whoever drives, and nothing that moves."""

import json
import math

import numpy as np
import pytest

from flipperctl.runtime import Attitude, Cloud, JointAngles, Mount, Odometry, RobotSetup
from flipperctl.runtime.__main__ import _main
from flipperctl.runtime.shadow import Shadow
from tests.runtime.linear import ROBOT, RULE, write

SETUP = RobotSetup(cloud_frame="base_link", mount=Mount(0.0, 0.0, np.pi / 2, 0.0, 0.05))
X, Y = np.meshgrid(np.linspace(-1, 2, 61), np.linspace(-0.5, 0.5, 11))
GROUND = np.column_stack([X.ravel(), Y.ravel(), np.full(X.size, -0.1)])


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return write(tmp_path_factory.mktemp("p") / "p.onnx", robot=ROBOT, targets=RULE)


def messages(now):
    return {
        "cloud": Cloud(now, "base_link", GROUND),
        "attitude": Attitude(now, "base_link", 0.0, 0.0, 0.0),
        "joints": JointAngles(now, 0.3, -0.2),
        "odometry": Odometry(now, 0.2),
    }


def test_a_pause_of_the_messages_is_answered_as_a_robots_timer_would(file):
    lines = []
    shadow = Shadow(file, SETUP, lines.append)
    for now in (0.0, 0.05, 0.1, 2.0, 2.05, 30.0):
        shadow.take(now, messages(now))
    found = shadow.summary()
    assert found["seconds"] == 30.0
    assert found["states"]["stopped"] > 0.5  # from 1.2 s, since nothing came after 0.1 s
    assert found["faults"]["joints_age"]["seconds"] == pytest.approx(1.75, abs=0.1)
    assert set(found["faults"]) == {"joints_age", "clock_jump"}
    assert found["faults"]["clock_jump"]["count"] == 1  # of 28 s
    assert all(json.loads(line)["measured"] == [0.3, -0.2] for line in lines)


def test_flippers_that_follow_someone_else_are_no_fault(file):
    shadow = Shadow(file, SETUP, str)
    for tick in range(100):
        shadow.take(tick * 0.05, messages(tick * 0.05))
    assert shadow.summary()["faults"] == {}
    assert shadow.summary()["decisions"] == 9  # in 4.95 s


def test_no_two_steps_are_farther_apart_than_a_tick(file, monkeypatch):
    shadow, times = Shadow(file, SETUP, str), []
    step = shadow._step
    monkeypatch.setattr(shadow, "_step", lambda now, m: (times.append(now), step(now, m)))
    for index in range(4):
        shadow.take(index * 0.099, messages(index * 0.099))
    shadow.take(0.347, messages(0.347))
    assert max(np.diff(times)) <= 0.05 + 1e-9


def test_angles_of_other_joints_are_not_logged(file):
    lines = []
    shadow = Shadow(file, SETUP, lines.append)
    shadow.take(0.0, messages(0.0))
    shadow.take(2.0, {"joints": JointAngles(2.0, math.nan, 0.0)})
    assert lines
    assert [json.loads(line)["measured"] for line in lines] == [[0.3, -0.2]] * len(lines)


def test_the_command_prints_the_log_of_lines_of_json(file, tmp_path, capsys):
    told = {
        "time": 0.0,
        "joints": {"front": 0.1, "rear": 0.1},
        "attitude": {"frame": "base_link", "roll": 0.0, "pitch": 0.0, "yaw_rate": 0.0},
    }
    (tmp_path / "m.jsonl").write_text(json.dumps(told) + "\n")
    assert _main(["--shadow", str(file), str(tmp_path / "m.jsonl"), "--signs", "rep103"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line)["fault"] == "cloud_missing"
