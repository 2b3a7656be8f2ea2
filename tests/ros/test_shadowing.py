"""``flipperctl robot shadow``: what a policy would have done on a robot's recording."""

import json
import math
import re
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader

from flipperctl.config import EvalConfig
from flipperctl.files import check_output
from flipperctl.policies.source import PolicySource
from flipperctl.ros.episode import ACTION, export_bag, write_bag
from flipperctl.ros.messages import typestore
from flipperctl.ros.recording import LOG
from tests.cli.call import call
from tests.ros.driving import FRONT, REAR, SECONDS, driving
from tests.runtime.linear import ROBOT, RULE, write


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A policy, a recording, and one whose clouds end after a second."""
    folder = tmp_path_factory.mktemp("shadow")
    write(folder / "p.onnx", robot=ROBOT, targets=RULE)
    messages = list(driving())
    write_bag(folder / "drive", messages)
    write_bag(folder / "blind", [m for m in messages if m.topic != "/points" or m.time < 1])
    return folder


def test_the_log_says_what_the_policy_would_have_done(folder):
    done = call("robot", "shadow", "p.onnx", "drive", "--output", "log.jsonl", "--json", cwd=folder)
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert found["decisions"] == sum(found["actions"].values()) == 4  # at 0, 0.6 … 1.8 s
    assert found["faults"] == {}
    assert found["states"] == {"driving": pytest.approx(SECONDS)}
    check_output(folder / "log.jsonl", LOG)  # a log of before is replaced
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    decided = [line for line in lines if line["action"] is not None]
    assert len(decided) == found["decisions"]
    assert decided[1]["time"] - decided[0]["time"] == pytest.approx(0.6)
    for line in decided:
        assert line["measured"] == pytest.approx([-FRONT, REAR])  # in the signs of ROS
        assert max(map(abs, line["targets"])) <= math.pi / 3 + 1e-9
        assert line["drive"] is True


def test_what_a_robot_would_refuse_is_in_the_log_with_the_reason(folder):
    done = call("robot", "shadow", "p.onnx", "blind", "--output", "blind.jsonl", cwd=folder)
    assert done.code == 0, done.err
    assert re.search(r"cloud is 0\.5\d s old; at most 0\.5 s is allowed", done.out)
    lines = [json.loads(line) for line in (folder / "blind.jsonl").read_text().splitlines()]
    assert [line["fault"] for line in lines if line["state"] == "holding"] == ["cloud_age"]
    assert lines[-1]["reason"].endswith("at most 0.5 s is allowed")


def test_an_episode_s_own_policy_proposes_what_it_did(folder):
    file = str(folder / "p.onnx")
    config = EvalConfig(
        terrain="step",
        perception={"name": "lidar", "pose": "belts", "azimuths": 60},
        episode={"run_up": 1.0, "run_out": 0.2},
    )
    export_bag(config, PolicySource(Path(file)), folder / "own")
    done = call("robot", "shadow", file, "own", "--output", "own.jsonl", cwd=folder)
    assert done.code == 0, done.err
    lines = [json.loads(line) for line in (folder / "own.jsonl").read_text().splitlines()]
    proposed = [line["action"] for line in lines if line["action"] is not None]
    types, did = typestore(), []
    with Reader(folder / "own") as reader:
        (actions,) = [c for c in reader.connections if c.topic == ACTION]
        for _, _, data in reader.messages(connections=[actions]):
            did.append(types.deserialize_cdr(data, actions.msgtype).data)
    assert proposed[: len(did)] == did
    assert len(set(did)) > 1


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["p.onnx", "drive", "robot=absolem"], "robot: the policy's file states the robot"),
        (["p.onnx", "drive", "perception.half_width=0.6"], "the settings of its map, which are"),
        (["p.onnx", "drive", "perception.pose=true"], "no robot knows this; belts or matched"),
    ],
)
def test_a_wrong_request_is_one_error(folder, words, error):
    done = call("robot", "shadow", *words, "--output", "wrong.jsonl", cwd=folder)
    assert (done.code, done.out) == (2, "")
    assert error in done.err
    assert not (folder / "wrong.jsonl").exists()
