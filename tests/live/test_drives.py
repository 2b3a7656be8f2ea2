"""Operators: commands between decisions, and drives that are repeated from their files."""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flipperctl.api import ACTIONS, Command, Outcome, Perception, Simulator, World, action_index
from flipperctl.checkpoint import recording
from flipperctl.config import EvalConfig
from flipperctl.env.drive import Commanding
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError, PolicyError, RequestError
from flipperctl.evaluation.play import EpisodeRunner, Player
from flipperctl.evaluation.replay import replay
from flipperctl.evaluation.rows import RECORDED
from flipperctl.live.drives import PRACTICE, DriveFolder, Task
from flipperctl.live.study import add_answers, read_study, tasks_of
from flipperctl.plugging.plugins import load
from flipperctl.policies.source import load_policy
from flipperctl.rollout.episode import decisions
from flipperctl.ros.episode import export_bag
from flipperctl.ros.messages import typestore

PERIOD = 0.05


class Script:
    """Stands for two seconds, raises the front, and drives on, backwards for a moment."""

    command_period = PERIOD

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = speed

    def reset(self, simulator: Simulator) -> None:
        self.ticks = 0

    def act(self, p: Perception) -> int:
        return action_index(0, 0)

    def command(self, world: World) -> Command:
        t, self.ticks = self.ticks * PERIOD, self.ticks + 1
        if t < 2.0:
            return Command(min(0.7, 0.5 * t), 0.0, 0.0)
        belts = -0.5 if 4.0 <= t < 4.5 else self.speed
        return Command(0.7 if t < 8 else -0.2, -0.3 if t > 10 else 0.0, belts, 1.0, float(t > 10))


def scene(sim: str, flippers: str = "pairs", **terrain: Any) -> EvalConfig:
    load(())
    step, robot = {"name": "step", **terrain}, {"flippers": flippers}
    return EvalConfig(terrain=step, sim=sim, robot=robot, eval={"episodes": 2})


def test_an_action_comes_closest_to_the_commands_and_carries_the_rest() -> None:
    operator = Commanding(5, lambda world: Command(0.0, 0.0), 0, limit=1.0, step=0.25)
    operator._followed = (0.0, 0.0)
    ends = [(0.12, 0.0), (0.2, -0.6), (0.2, -0.6), (0.2, -0.6), (0.9, -0.6)]
    moves = [ACTIONS[operator.end(targets)[0]] for targets in ends]
    assert moves == [(0, 0), (1, -1), (0, -1), (0, 0), (1, 0)]


def test_a_command_waits_for_the_delay_of_the_actuators() -> None:
    class Told:
        def __init__(self) -> None:
            self.got: list[tuple[float, ...]] = []

        def command(self, front: float, rear: float) -> None:
            self.got.append((front, rear))

        def run_belts(self, share: float) -> None:
            self.got.append((share,))

    fronts = iter([0.1, 0.2, 3.0])
    world = Told()
    operator = Commanding(5, lambda world: Command(next(fronts), 0.0, 0.5), 2, limit=1.0, step=0.25)
    targets = (0.0, 0.0)
    for _ in range(3):
        targets = operator.command(world, targets)  # type: ignore[arg-type]
    assert world.got == [(0.1, 0.0), (0.5,)]
    assert targets == (0.1, 0.0)
    assert [c.front for c in operator.commands] == [0.1, 0.2, 3.0]


@pytest.mark.parametrize("sim", ["planar", "mujoco"])
def test_the_belts_stand_and_run_back(sim: str) -> None:
    pytest.importorskip("mujoco")
    env = FlipperEnv(config=scene(sim))
    places = [np.empty(0)]
    for decision in decisions(env, Script(), 3):
        places.append(decision.poses[:-1, 0])
        if decision.transition.after.time > 6:
            break
    x = np.concatenate(places)  # every 10 ms
    assert np.ptp(x[150:195]) < 0.005
    assert x[360] - x[300] == pytest.approx(0.12, abs=0.01)
    assert x[450] - x[410] == pytest.approx(-0.04, abs=0.01)
    assert decision.transition.commands is not None
    assert decision.transition.commands.shape == (12, 5)


def test_who_waits_is_not_stuck() -> None:
    class Waits(Script):
        def command(self, world: World) -> Command:
            return Command(0.0, 0.0, 0.0)

    env = FlipperEnv(config=scene("planar"))
    *_, last = decisions(env, Waits(), 3)
    assert last.transition.outcome is Outcome.TIMEOUT


class Lifting(Script):
    """The same, with the right flippers raised a little more."""

    def command(self, world: World) -> Command:
        c = super().command(world)
        return c._replace(flippers=(c.front, c.front + 0.1, c.rear, c.rear + 0.3))


@pytest.mark.parametrize(
    ("sim", "flippers", "script", "numbers"),
    [
        ("planar", "pairs", Script, 5), ("mujoco", "pairs", Script, 5),
        ("mujoco", "four", Script, 9), ("mujoco", "four", Lifting, 9),
    ],
)  # fmt: skip
def test_a_drive_is_repeated_bit_for_bit(
    sim: str, flippers: str, script: type[Script], numbers: int, tmp_path: Path
) -> None:
    pytest.importorskip("mujoco")
    config = scene(sim, flippers, height=[0.12, 0.14])
    folder = DriveFolder(tmp_path / "anna", "script: test")
    row = folder.drive(config, FlipperEnv(config=config), script(), 0)
    (episode,) = recording.read(folder.path).episodes
    assert episode.commands is not None
    assert episode.commands.shape[1] == numbers
    assert folder.missing(config, 0, 2) == [1]
    assert folder.next(config, None, 2) == [1, 2]
    with pytest.raises(RequestError, match=r"--episode 0: .* holds a drive of it"):
        folder.next(config, 0, 1)
    source = load_policy(tmp_path / "anna")
    assert EpisodeRunner(config, source, config.eval.seed).play(0) == row
    (record,) = (tmp_path / "anna").glob("*.json")
    again = replay(record)
    assert again.differences == []
    assert row["taken"] == pytest.approx(again.episode["taken"])
    assert 1.9 < row["belts_stood"] < 2.2
    assert 0.5 < row["taken"] < 1


def test_drives_are_refused_elsewhere(tmp_path: Path) -> None:
    config = scene("planar")
    path = tmp_path / "anna"
    folder = DriveFolder(path, "script: test")
    folder.drive(config, FlipperEnv(config=config), Script(), 0)
    source = load_policy(path)
    with pytest.raises(PolicyError, match="no drive of this draw on step"):
        EpisodeRunner(config, source, config.eval.seed).play(1)
    other = config.model_copy(update={"sim": EvalConfig(terrain="step", sim="planar").sim})
    assert source.build(other) is not None
    slippery = EvalConfig(terrain="step", sim={"name": "planar", "friction": 0.5})
    with pytest.raises(ConfigError, match=r"driven with sim\.friction=1\.0 \(here 0\.5\)"):
        source.build(slippery)
    with pytest.raises(RequestError, match="one operator"):
        DriveFolder(path, "person: ben")


def test_drives_teach_and_read_as_one_file(tmp_path: Path) -> None:
    config = scene("planar")
    folder = DriveFolder(tmp_path / "anna", "script: test")
    for index in (0, 1):
        folder.drive(config, FlipperEnv(config=config), Script(), index)
    found = recording.read(tmp_path / "anna")
    assert [e.number for e in found.episodes] == sorted(e.number for e in found.episodes)
    assert len(found.episodes) == 2
    for episode in found.episodes:
        assert (episode.labels.argmax(1) == episode.actions).all()
        assert len(episode.actions) + 1 == len(episode.observations)
    with Player() as player:
        played = player.play(config, load_policy(tmp_path / "anna"), "anna", record=True)
    kept = [row[RECORDED] for row in played]
    by_number = {e.number: e for e in found.episodes}
    for one in kept:
        assert np.array_equal(one.actions, by_number[one.number].actions)
        assert np.array_equal(one.labels, by_number[one.number].labels)
    assert math.isfinite(sum(float(one.rewards.sum()) for one in kept))


STUDY = """
scenes:
  low: terrain=step
  high: terrain=step terrain.height=[0.2,0.4]
people: [anna, ben, cleo, dan]
helpers: [none, okada]
repeats: 2
"""


def test_a_study_balances_its_blocks_and_goes_on_where_it_stopped(tmp_path: Path) -> None:
    file = tmp_path / "study.yaml"
    file.write_text(STUDY)
    found = read_study(file, "ben")
    orders = [found.blocks(person) for person in found.people]
    for place in range(4):  # each block once at each place
        assert len({order[place] for order in orders}) == 4
    follows = [pair for order in orders for pair in pairwise(order)]
    assert len(set(follows)) == 12  # and each after each other one once
    config = scene("planar")

    def tasks() -> list[Task]:
        return list(
            tasks_of(
                found, "ben", lambda words: config, load_policy,
                lambda helper: DriveFolder(tmp_path / f"ben+{helper}", "script: ben"),
            )
        )  # fmt: skip

    planned = tasks()
    assert [(t.practice, t.asks != "") for t in planned[:3]] == [
        (True, False), (False, False), (False, True),
    ]  # fmt: skip
    assert planned[0].index >= PRACTICE
    first = planned[1]
    first.folder.drive(config, FlipperEnv(config=config), Script(), first.index)
    assert first.index not in [t.index for t in tasks()[:2]]
    add_answers(tmp_path, "ben", "none", "low", (0, 10, 20, 30, 40, 50))
    add_answers(tmp_path, "ben", "okada", "high", (0, 0, 0, 0, 0, 3))
    lines = (tmp_path / "answers.csv").read_text().splitlines()
    assert lines[1:] == ["ben,none,low,0,10,20,30,40,50,25.0", "ben,okada,high,0,0,0,0,0,3,0.5"]


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("scenes: [", "no YAML"),
        (STUDY.replace("repeats: 2", "repeats: 0"), "repeats"),
        (STUDY.replace("ben", "bea"), "no such person; anna, bea, cleo, dan are allowed"),
        (STUDY.replace("dan", "anna"), "people: 'anna' is named twice"),
    ],
)
def test_a_wrong_study_is_one_error(text: str, error: str, tmp_path: Path) -> None:
    file = tmp_path / "study.yaml"
    file.write_text(text)
    with pytest.raises(RequestError, match=error):
        read_study(file, "ben")


def test_a_bag_of_a_drive_has_the_speed_of_its_belts(tmp_path: Path) -> None:
    rosbags = pytest.importorskip("rosbags.highlevel")
    config = EvalConfig(
        terrain={"name": "step", "platform": 0.4},
        episode={"run_up": 0.8, "run_out": 0.2},
        perception={"name": "lidar", "azimuths": 30, "pose": "belts"},
    )
    folder = DriveFolder(tmp_path / "anna", "script: test")
    row = folder.drive(config, FlipperEnv(config=config), Script(), 0)
    bag = tmp_path / "bag"
    export_bag(config, load_policy(tmp_path / "anna"), bag)
    with rosbags.AnyReader([bag], default_typestore=typestore()) as reader:
        (channel,) = (c for c in reader.connections if c.topic == "/belt_speed")
        messages = reader.messages([channel])
        belts = [reader.deserialize(data, channel.msgtype).data for _, _, data in messages]
    assert min(belts) == pytest.approx(-0.1, rel=0.02)  # half of the speed, back
    stood = belts.count(0.0) / len(belts) * row["t_cost"]
    assert stood == pytest.approx(row["belts_stood"], abs=0.2)
