"""An operator's drive on topics becomes the record that ``drive`` makes."""

import json
import math
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flipperctl.checkpoint import recording as recordings
from flipperctl.commands.robot import recorded_robot
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.learners import recorded
from flipperctl.requests.compose import compose_train
from flipperctl.requests.text import from_words
from flipperctl.rollout.episode import EvaluationSeeds, decisions
from flipperctl.ros.simulate import Link, TopicRobot
from flipperctl.runtime.devices import devices_of
from flipperctl.runtime.node import RobotNode
from tests.cli.call import call
from tests.ros.recorder import Recorder, recording
from tests.ros.test_simulate import OTHER, Joined

SCENE = ("terrain=paper_step", "sim=mujoco", "perception.azimuths=60")
SECONDS, STEP = 9.0, math.pi / 12


class Driven(Joined):
    """Joins a robot with a node whose operator drives it, and records what both say."""

    def __init__(self, node: RobotNode, recorder: Recorder, *, by_hand: bool) -> None:
        super().__init__(node)
        self.recorder, self.by_hand, self.begun, self.now = recorder, by_hand, math.nan, math.nan

    def sent(self, topic: str, message: Any) -> None:
        if topic == "/clock":
            self.now = message.clock.sec + 1e-9 * message.clock.nanosec
            self.begun = self.now if math.isnan(self.begun) else self.begun
        if topic != "/tf_static":  # the file of devices tells the place of the LiDAR
            self.recorder.write(topic, message, 1_000_000.0 if math.isnan(self.now) else self.now)
        if topic == "simulation/tick" and self.by_hand:
            self.node.joy(self.now, self.joy(self.now - self.begun))
        super().sent(topic, message)

    def joy(self, time: float) -> Any:
        """Two steps up with the front flippers from 1 s on, and one down from 5 s on."""
        turn = STEP / 0.4363323129985824  # time of a step [s]
        up, down = 1.0 <= time < 1.0 + 2 * turn, 5.0 <= time < 5.0 + turn
        axes = [0.0] * 8
        axes[1], axes[4] = 1.0, float(up) - float(down)
        return SimpleNamespace(buttons=[0, 0, 0, 0, 0, 1], axes=axes)

    def obey(self, command: Any) -> None:
        self.recorder.diagnosis({"state": "standby", "commands": command.source}, self.now)
        super().obey(command)


def bag_of(folder: Path, policy: Path, *, by_hand: bool) -> None:
    """Write the bag of a drive, and the file of the robot's devices."""
    devices = devices_of(OTHER, "test")
    (folder / "d.json").write_text(json.dumps(OTHER))
    config = recorded_robot(SCENE, devices).config
    with recording(folder / "bag", devices) as recorder:
        node = RobotNode(policy, devices, trusted=True)
        robot = TopicRobot(
            Driven(node, recorder, by_hand=by_hand), devices, config, Link(lockstep=True)
        )
        robot.prepare(0)
        env, seed = FlipperEnv(config=config), EvaluationSeeds.of(0, config.terrain)(0)
        played = decisions(env, robot, seed, observers=(robot,))
        assert len(list(islice(played, round(SECONDS / 0.6)))) == round(SECONDS / 0.6)


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("policy")
    assert call("export", "onnx", "generalist", "--output", "p.onnx", cwd=folder).code == 0
    return folder / "p.onnx"


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory, policy: Path) -> tuple[Path, Any]:
    folder = tmp_path_factory.mktemp("field")
    bag_of(folder, policy, by_hand=True)
    words = "bag", "devices=d.json", "--outcome", "reached", "--as", "anna", "--json"
    done = call("robot", "drive", *words, cwd=folder)
    assert done.code == 0, done.err
    return folder, json.loads(done.out)


def test_a_field_drive_has_its_observations_actions_and_measures(
    field: tuple[Path, Any],
) -> None:
    folder, document = field
    (drive,) = document["drives"]
    assert drive["outcome"] == "reached"
    assert drive["t_cost"] == pytest.approx(SECONDS, abs=1.3)
    assert drive["way_of_belts"] == pytest.approx(0.2 * SECONDS, abs=0.15)  # they slip at the step
    assert drive["belts_stood"] < 0.1
    file = folder / "drives" / "anna" / "drive_field_bag.safetensors"
    episode = recordings.read(file).episodes[0]
    turns = [(int(action) // 3 - 1, int(action) % 3 - 1) for action in episode.actions]
    fronts = [front for front, _ in turns if front]
    assert fronts == [1, 1, -1]
    assert {rear for _, rear in turns} == {0}
    # Level ground ahead at first, 0.1 m below the chassis centre; angles above are positive.
    bins = (episode.observations.shape[1] - 3) // 2
    assert episode.observations[0][: bins - 2] == pytest.approx(-0.1, abs=0.03)
    assert episode.observations[-1][-3] == pytest.approx(STEP, abs=0.03)
    assert np.array_equal(episode.labels.argmax(axis=1), episode.actions)


def test_a_training_learns_from_a_field_drive_and_no_simulation_plays_it(
    field: tuple[Path, Any],
) -> None:
    folder, document = field
    words = "terrain=step", "perception=lidar", "teacher=recorded", "agent.privileged_value=false"
    words = *words, f"teacher.episodes={folder / 'drives' / 'anna'}", "teacher.td_weight=0"
    (config,) = compose_train(from_words(words))
    assert recorded.read_teacher(config).decisions == document["drives"][0]["decisions"]
    assert any(
        "sim=field" in text for text in recorded.notes(config, recorded.read_teacher(config))
    )
    played = call("eval", "drives/anna", "terrain=step", "--episodes", "1", cwd=folder)
    assert (played.code, played.err.count("error:")) == (2, 1)
    assert "of a field drive nobody knows the ground" in played.err
    again = call("robot", "drive", "bag", "--outcome", "reached", "--as", "ben", cwd=folder)
    assert again.code == 2  # the bag has other names than nubot's


def test_what_the_policy_drove_is_no_drive_of_an_operator(tmp_path: Path, policy: Path) -> None:
    bag_of(tmp_path, policy, by_hand=False)
    done = call("robot", "drive", "bag", "devices=d.json", "--outcome", "reached", cwd=tmp_path)
    assert (done.code, "decisions that an operator commanded" in done.err) == (2, True)
