"""Flippers of a robot whose belts do not drive ahead are held; a policy never saw that."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.messages import Pose
from flipperctl.runtime import Answer, FlipperController, JointAngles, Odometry, OnnxPolicy
from tests.runtime.linear import RISK, ROBOT, RULE, SIZE, write
from tests.runtime.messages import IN_CHASSIS, RELAXED, good

STEP = 0.05
"""Time between two steps of the controller [s]."""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy that always warns, and so draws all its actions, nearly with equal chances."""
    return write(
        tmp_path_factory.mktemp("eager") / "p.onnx",
        robot=ROBOT,
        targets=RULE,
        risky=True,
        risk={**RISK, "threshold": 0.001},
        escape={"temperature": 100.0, "decisions": 4},
    )


class Robot:
    """A robot on level ground whose flippers follow the setpoints."""

    def __init__(self, controller: FlipperController) -> None:
        self.controller, self.now, self.angles = controller, 0.0, (0.3, -0.2)

    def run(self, seconds: float, speed: float | None, **changes: Any) -> list[Answer]:
        """Step with belts of this speed; None: without encoders."""
        answers = []
        for _ in range(round(seconds / STEP)):
            told = {**good(self.now), "joints": JointAngles(self.now, *self.angles)}
            if round(self.now / STEP) % 4:  # five clouds a second
                told["cloud"] = None
            told["odometry"] = None if speed is None else Odometry(self.now, speed)
            answers.append(self.controller.step(self.now, **{**told, **changes}))
            self.angles = answers[-1].setpoints or self.angles
            self.now += STEP
        return answers

    def turned(self, front: float, rear: float, speed: float) -> Answer:
        """Step once while an operator turns the flippers to these angles [rad]."""
        (answer,) = self.run(STEP, speed, joints=JointAngles(self.now, front, rear))
        return answer


@pytest.fixture
def robot(file: Path) -> Robot:
    return Robot(FlipperController(file, IN_CHASSIS, RELAXED, escape=True))


def decided(answers: list[Answer]) -> list[Answer]:
    return [answer for answer in answers if answer.action is not None]


@pytest.mark.parametrize(("speed", "told"), [(0.0, "0.00"), (0.019, "0.02"), (-0.2, "-0.20")])
def test_a_robot_whose_belts_do_not_drive_ahead_commands_nothing(
    robot: Robot, speed: float, told: str
) -> None:
    lines: list[str] = []
    robot.controller._log = lines.append
    answers = robot.run(3.0, speed)
    assert {answer.state for answer in answers} == {"standby"}
    (line,) = map(json.loads, lines)
    assert (line["state"], line["fault"], line["action"]) == ("standby", "", None)
    assert robot.angles == (0.3, -0.2)
    assert {(answer.targets, answer.setpoints) for answer in answers} == {(None, None)}
    last = answers[-1]
    assert (last.drive, last.fault, last.risk, last.warning) == (True, "", None, False)
    assert last.reason.startswith(f"the belts drive at {told} m/s; the policy decides nothing")


@pytest.mark.parametrize("speed", [0.2, None], ids=["slipping", "without encoders"])
def test_a_robot_that_is_stuck_while_its_belts_drive_goes_on(
    robot: Robot, speed: float | None
) -> None:
    if speed is None:  # it waits for a speed that may still come
        first = robot.run(0.3, speed)
        assert {(a.state, a.fault) for a in first} == {("waiting", "odometry_missing")}
    answers = robot.run(6.0, speed)
    assert {answer.state for answer in answers} == {"driving"}
    assert len(decided(answers)) == 10
    assert all(answer.warning for answer in decided(answers))
    assert len({answer.action for answer in decided(answers)}) > 3  # drawn


def test_a_robot_whose_pose_shows_that_it_stands_warns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calm = {**RISK, "threshold": 0.99}
    file = write(tmp_path / "p.onnx", robot=ROBOT, targets=RULE, risky=True, risk=calm)
    robot = Robot(FlipperController(file, IN_CHASSIS, RELAXED))
    assert not any(answer.warning for answer in robot.run(9.0, 0.2))  # by its belts it drives
    monkeypatch.setattr(LidarEstimator, "pose", Pose(1.8, 0.3, 0.0, 0.0, 0.0, 0.0))
    warnings = [answer.warning for answer in decided(robot.run(9.0, 0.2))]
    assert warnings == [False] * warnings.index(True) + [True] * warnings.count(True)
    assert 7 <= warnings.index(True) <= 10


def test_nothing_is_commanded_soon_after_the_belts_stand(robot: Robot) -> None:
    robot.run(1.3, 0.2)
    answers = robot.run(2.0, 0.0)
    states = [answer.state for answer in answers]
    assert states == ["driving"] * 10 + ["standby"] * 30  # standby_after
    assert {answer.targets for answer in answers[10:]} == {None}


def test_belts_that_hesitate_are_no_stop(robot: Robot) -> None:
    robot.run(1.0, 0.2)
    answers = [answer for _ in range(4) for answer in robot.run(0.5, 0.0) + robot.run(0.1, 0.2)]
    assert {answer.state for answer in answers} == {"driving"}


def test_belts_that_start_again_begin_an_episode(robot: Robot) -> None:
    begun = decided(robot.run(3.0, 0.2))
    robot.run(2.0, 0.0)
    for _ in range(6):
        assert robot.turned(-0.5, 0.6, 0.2).state == "standby"  # until standby_until
    robot.angles = (-0.5, 0.6)
    again = robot.run(3.0, 0.2)
    assert again[0].action is not None  # at once
    assert [answer.action for answer in decided(again)] == [answer.action for answer in begun]
    assert again[0].risk == pytest.approx(begun[0].risk, abs=0.01)  # of one observation
    turns = robot.controller.policy.interface.actions[again[0].action]
    assert again[0].targets == pytest.approx(np.array([-0.5, 0.6]) + turns)
    assert again[0].setpoints == pytest.approx((-0.5, 0.6), abs=0.436 * STEP + 1e-9)


def test_what_keeps_it_from_deciding_is_told_before_the_belts_start(file: Path) -> None:
    blind = Robot(FlipperController(file, IN_CHASSIS, replace(RELAXED, coverage=1.1)))
    answers = blind.run(1.0, 0.0)
    assert {(a.state, a.fault, a.drive) for a in answers} == {("waiting", "coverage", False)}
    dead = Robot(FlipperController(file, IN_CHASSIS, RELAXED))
    session, dead.controller.policy._session = dead.controller.policy._session, None
    assert {answer.fault for answer in dead.run(0.8, 0.0)} == {"inference"}
    dead.controller.policy._session = session
    assert dead.run(0.8, 0.0)[-1].state == "standby"


def test_a_fault_in_standby_stops_the_belts_and_ends(robot: Robot) -> None:
    robot.run(1.0, 0.2)
    robot.run(1.0, 0.0)
    assert robot.run(2.0, 0.0, cloud=None)[-1].drive is False
    assert {answer.drive for answer in robot.run(1.95, 0.0)} == {False}  # rest
    assert robot.run(0.1, 0.0)[-1].state == "standby"


def test_without_escapes_each_action_is_the_best(file: Path) -> None:
    seen = np.linspace(-1, 1, SIZE)  # of which the last of the nine heights is largest
    drawing, best = OnnxPolicy(file, escape=True), OnnxPolicy(file, escape=False)
    drawn = [drawing.act(seen) for _ in range(20)]
    assert len(set(drawn)) > 4
    assert [best.act(seen) for _ in range(20)] == [8] * 20
    assert best.risk == drawing.risk
    assert best.warning
    calm = Robot(FlipperController(file, IN_CHASSIS, RELAXED))
    answers = decided(calm.run(3.0, 0.2))
    same = decided(Robot(FlipperController(file, IN_CHASSIS, RELAXED)).run(3.0, 0.2))
    assert [answer.action for answer in answers] == [answer.action for answer in same]
    assert all(answer.warning for answer in answers)


def test_single_speeds_move_no_flipper_of_a_parked_robot(robot: Robot) -> None:
    robot.run(1.0, 0.0)
    answers = []
    for speed in (0.03, 0.0, 0.05, -0.01, 0.2):
        answers += robot.run(0.1, speed) + robot.run(0.1, 0.0)
    answers += robot.run(1.0, 0.0)
    assert {answer.state for answer in answers} == {"standby"}
    assert robot.angles == (0.3, -0.2)


def test_an_operator_turns_the_flippers_in_standby_without_a_fault(robot: Robot) -> None:
    robot.run(1.0, 0.2)
    robot.run(1.0, 0.0)
    fronts = [*np.linspace(0.3, 1.4, 80), *([0.9] * 60)]  # 1.4 rad is past the policy's limit
    answers = [robot.turned(float(front), -0.2, 0.0) for front in fronts]
    assert {(answer.state, answer.fault) for answer in answers} == {("standby", "")}
    assert {answer.targets for answer in answers} == {None}  # an operator's command stands


def test_a_parked_robot_does_not_move_before_its_first_speed_comes(robot: Robot) -> None:
    answers = [*robot.run(0.1, None), *robot.run(1.0, 0.0)]
    assert decided(answers) == []
    assert [answer.state for answer in answers[:3]] == ["waiting", "waiting", "standby"]
