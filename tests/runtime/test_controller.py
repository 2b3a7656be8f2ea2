"""The robot's controller: the simulator's actions, and a safe answer to whatever goes wrong."""

import json
import math
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from flipperctl.config import EnvConfig
from flipperctl.core.lidar.body import attitude as rotation
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.messages import Belts, Inertial, Joints, Scan
from flipperctl.core.sensing import Measured
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import PolicyError
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import decisions
from flipperctl.runtime import (
    REP_103,
    Ages,
    Attitude,
    Cloud,
    FlipperController,
    JointAngles,
    Limits,
    Odometry,
    Signs,
)
from tests.runtime.linear import FOUR, MAP, RATES, ROBOT, RULE, write
from tests.runtime.messages import GROUND, IN_CHASSIS, RELAXED, drive, good


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy whose action is the bin of the highest of the nine rear heights."""
    path = tmp_path_factory.mktemp("policy") / "linear.onnx"
    return write(path, robot=ROBOT, targets=RULE)


@pytest.fixture
def controller(file: Path) -> FlipperController:
    return FlipperController(file, IN_CHASSIS, RELAXED)


@pytest.mark.parametrize("kind", [{}, RATES, FOUR], ids=["turns", "rates", "four"])
def test_an_episode_by_its_messages_has_the_actions_of_the_simulator(
    kind: dict[str, object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stated = {**MAP, "fewest": 2}
    file = write(tmp_path / "p.onnx", robot=ROBOT, targets=RULE, map=stated, **kind)
    recorded: list[Measured] = []
    update = LidarEstimator.update
    with monkeypatch.context() as patch:
        patch.setattr(
            LidarEstimator, "update", lambda self, m: (recorded.append(m), update(self, m))[1]
        )
        perception = {"name": "lidar", "pose": "belts", "azimuths": 60, **stated}
        four = {"sim": "mujoco", "robot": {"flippers": "four"}} if kind is FOUR else {}
        env = FlipperEnv(config=EnvConfig(terrain={"name": "step"}, perception=perception, **four))
        policy = PolicySource(file).build(env.config)
        driven = list(islice(decisions(env, policy, 8), 10))
        actions = [d.rates or d.action for d in driven]
    controller = FlipperController(file, limits=RELAXED, shadow=True)  # the simulator turns them
    kinds = {Scan: "cloud", Inertial: "attitude", Joints: "joints", Belts: "odometry"}
    taken = []
    recorded = [m for m in recorded if type(m.value) in kinds]
    for time in sorted({m.time for m in recorded}):
        messages = {kinds[type(m.value)]: told(m) for m in recorded if m.time == time}
        answer = controller.step(time, **messages)
        assert not answer.fault, answer.reason
        if answer.action is not None:
            taken.append(answer.action)
    assert len(actions) == 10
    assert taken[: len(actions)] == actions
    assert len(set(actions)) > 1


def heights(file: Path) -> np.ndarray:
    """What a controller of the file sees of kerbs ahead that leave its line free, (30,)."""
    controller = FlipperController(file, IN_CHASSIS, RELAXED)
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-1, 2, 241), np.linspace(-0.6, 0.6, 49)))
    kerb = np.column_stack([x, y, np.where((np.abs(y) > 0.2) & (x > 0.8), 0.0, -0.1)])
    controller.step(0.0, **good(0.0, cloud=Cloud(0.0, "base_link", kerb)))
    ground, _ = controller._estimator.estimate(0.0)
    return ground.heights


def test_a_wide_robot_sees_the_width_of_its_training(file: Path, tmp_path: Path) -> None:
    wide = write(tmp_path / "wide.onnx", robot=ROBOT, targets=RULE, map=MAP)
    # The kerbs make up 44 % of the ground within 0.36 m of the line, and 67 % of that within 0.6 m.
    assert heights(file)[-1] == pytest.approx(-0.1, abs=0.005)
    assert heights(wide)[-1] == pytest.approx(0.0, abs=0.005)


def told(m: Measured) -> object:
    """Return the message as a driver would send it."""
    v = m.value
    if isinstance(v, Scan):
        return Cloud(m.time, "lidar", v.points, v.ages)
    if isinstance(v, Inertial):
        return Attitude(m.time, "base_link", v.roll, v.pitch, v.yaw_rate)
    if isinstance(v, Joints):
        if not v.flippers:
            return JointAngles(m.time, v.front, v.rear)
        front, rear = np.array(v.flippers[:2]) - v.front, np.array(v.flippers[2:]) - v.rear
        return JointAngles(m.time, v.front, v.rear, (tuple(front), tuple(rear)))
    return Odometry(m.time, v.speed)


@pytest.mark.parametrize(
    ("changes", "fault", "within"),
    [
        ({"cloud": None}, "cloud_age", 0.55),
        ({"cloud": Cloud(1.1, "base_link", "points")}, "cloud_shape", 0.55),
        ({"cloud": Cloud(1.1, "base_link", GROUND, [0.0])}, "cloud_shape", 0.55),
        ({"attitude": Attitude(1.1, "odom", 0, 0, 0)}, "attitude_frame", 0.15),
        ({"attitude": Attitude(1.1, np.zeros(3), 0, 0, 0)}, "attitude_frame", 0.15),
        ({"joints": 0.3}, "joints_kind", 0.25),
    ],
)
def test_a_bad_input_holds_the_flippers_in_time_and_then_stops(
    controller: FlipperController, changes: dict, fault: str, within: float
) -> None:
    begun = now = drive(controller)
    states = {}
    while "stopped" not in states:
        now += 0.05
        answer = controller.step(now, **good(now, **changes))
        states.setdefault(answer.state, (now, answer))
        assert now < begun + 3
    held, stopped = states["holding"], states["stopped"]
    assert held[1].fault == stopped[1].fault == fault
    assert held[0] - begun <= within + 1e-6
    assert held[1].drive
    assert not stopped[1].drive
    assert stopped[0] - held[0] == pytest.approx(1.0, abs=0.06)
    assert stopped[1].targets == pytest.approx((0.1, 0.2))  # the measured angles
    gap = fault.endswith("_age")
    assert stopped[1].latched is not gap
    answers = [controller.step(now + 0.05 * i, **good(now + 0.05 * i)) for i in range(1, 61)]
    assert [answer.drive for answer in answers] == [gap and i >= 39 for i in range(60)]  # rest
    controller.acknowledge()
    assert controller.step(now + 3.05, **good(now + 3.05)).state == "driving"


@pytest.mark.parametrize("jump", [-0.5, 30.0])
def test_a_clock_that_jumps_stops_and_what_was_known_is_forgotten(file: Path, jump: float) -> None:
    lines: list[str] = []
    controller = FlipperController(file, IN_CHASSIS, RELAXED, lines.append)
    now = drive(controller, 1.3) + jump
    answer = controller.step(now)
    assert (answer.state, answer.drive, answer.fault) == ("stopped", False, "clock_jump")
    assert answer.targets is None
    assert not controller.step(now + 0.05, **good(now + 0.05)).drive
    controller.acknowledge()
    assert controller.step(now + 0.1).state == "driving"  # by the messages since
    assert controller.step(now + 0.15, **good(now + 0.15)).state == "driving"
    logged = [json.loads(line) for line in lines]  # each decision and each change of state
    assert [e["time"] for e in logged[:3]] == pytest.approx([0.0, 0.6, 1.2])
    assert all(e["action"] is not None for e in logged[:3])
    assert logged[3]["fault"] == "clock_jump"


def test_a_time_is_a_finite_number_of_python_or_numpy(controller: FlipperController) -> None:
    for time in (10**400, 10**5000, True, "3", None, math.nan):
        answer = controller.step(time)
        assert (answer.fault, answer.state, answer.drive) == ("clock", "stopped", False)
        assert answer.reason.endswith("a finite number is allowed")
    for kind in (np.float32, np.float64, np.int64):
        assert controller.step(kind(3), **good(3.0)).fault != "clock"


def test_too_little_ground_holds_and_is_looked_at_once_in_a_period(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = FlipperController(file, IN_CHASSIS, replace(RELAXED, coverage=1.1))
    tried = []
    estimate = LidarEstimator.estimate
    monkeypatch.setattr(
        LidarEstimator, "estimate", lambda self, t: (tried.append(t), estimate(self, t))[1]
    )
    answers = [controller.step(0.05 * i, **good(0.05 * i)) for i in range(25)]
    assert {answer.fault for answer in answers} == {"coverage"}
    assert tried == pytest.approx([0.0, 0.6, 1.2])


def test_a_network_that_gives_no_number_holds(tmp_path: Path) -> None:
    file = write(tmp_path / "linear.onnx", robot=ROBOT, targets=RULE)
    controller = FlipperController(file, IN_CHASSIS, RELAXED)
    controller.policy._limits[:] = math.inf
    now = drive(controller) + 0.05
    controller.policy._session = None  # every run fails from here on
    for _ in range(12):
        now += 0.05
        answer = controller.step(now, **good(now))
    assert answer.fault == "inference"
    assert answer.targets == pytest.approx((0.1, 0.2))
    assert answer.action is None


def test_a_flipper_that_does_not_follow_is_not_pushed(file: Path) -> None:
    limits = Limits(ages=Ages(joints=0.2), stall_time=1.0)
    controller = FlipperController(file, IN_CHASSIS, limits)
    faults = set()
    for i in range(60):
        now = 0.05 * i
        answer = controller.step(now, **good(now))  # the angles never change
        faults.add(answer.fault)
        if answer.fault == "stall":
            assert "flippers do not follow" in answer.reason
            assert answer.targets == pytest.approx((0.1, 0.2))
    assert faults == {"", "stall"}


def test_the_targets_are_in_the_signs_of_the_robot(file: Path) -> None:
    ours = FlipperController(file, IN_CHASSIS, RELAXED)
    theirs = FlipperController(
        file,
        replace(IN_CHASSIS, signs=REP_103),
        RELAXED,
    )
    a = ours.step(0.0, **good(0.0))
    b = theirs.step(0.0, **good(0.0, joints=JointAngles(0.0, -0.1, 0.2)))
    assert a.action == b.action
    assert (-b.targets[0], b.targets[1]) == pytest.approx(a.targets)
    with pytest.raises(PolicyError, match=r"signs\.x is 0; 1 or -1 is allowed"):
        Signs(x=0)


def test_setpoints_of_a_decision_begin_when_it_is_made(controller: FlipperController) -> None:
    """However late it is made: the time before went to the targets before, at the robot's speed."""
    controller._motions.clear()
    points = [controller.step(0.05 * i, **good(0.05 * i)).setpoints for i in range(11)]
    steps = np.abs(np.diff(np.array(points), axis=0))
    assert 0 < steps.max() <= 0.436 * 0.05 + 1e-9
    before = controller.step(0.55, **good(0.55))
    after = controller.step(1.4, **good(1.4))
    assert after.action is not None
    assert after.targets != before.targets
    assert after.setpoints == before.targets


def test_any_input_gets_an_answer(controller: FlipperController) -> None:
    """As ``python -m benchmarks.controller`` does with a million steps."""
    from benchmarks.controller import Garbage

    garbage = Garbage(5, odd=0.1)
    faults = set()
    for step in range(300):
        now, messages = garbage.draw()
        if step % 20 == 0:
            controller.acknowledge()
        answer = controller.step(now, **messages)
        faults.add(answer.fault)
        assert answer.targets is None or np.abs(answer.targets).max() <= math.pi + 1e-9
        assert answer.drive is (answer.state in ("standby", "driving", "holding"))
        assert bool(answer.reason) is bool(answer.fault or answer.state == "standby")
        assert answer.targets is None or answer.state not in ("waiting", "standby")
    assert len(faults) > 8
    assert "" in faults


def test_after_a_fault_the_setpoints_begin_where_the_flippers_are_by_then(
    controller: FlipperController,
) -> None:
    now = drive(controller)
    for _ in range(60):  # no clouds
        now += 0.05
        answer = controller.step(now, **good(now, cloud=None))
    assert answer.state == "stopped"
    for _ in range(60):
        now += 0.05
        answer = controller.step(now, **good(now, joints=JointAngles(now, -0.5, 0.2)))
        if answer.action is not None:
            break
    assert abs(answer.setpoints[0] + 0.5) < 0.05
    assert abs(answer.targets[0] + 0.5) < math.pi / 12 + 0.01


def seen(controller: FlipperController, now: float) -> np.ndarray:
    return controller._estimator.estimate(now)[0].heights


def posture(now: float, **changes: object) -> dict[str, object]:
    """Messages of a robot at rest on a slope of 0.3 rad."""
    told = {"attitude": Attitude(now, "base_link", 0.0, 0.3, 0.0), "odometry": Odometry(now, 0.0)}
    return good(now, **{**told, **changes})


def tipped(now: float, **changes: object) -> dict[str, object]:
    """Messages of a robot that has tipped up by 0.3 rad above level ground."""
    points = Cloud(now, "base_link", GROUND @ rotation(0.0, 0.3, 0.0))
    told = {"attitude": Attitude(now, "base_link", 0.0, 0.3, 0.0), "cloud": points}
    return good(now, **{**told, "odometry": Odometry(now, 0.025), **changes})


@pytest.mark.parametrize("late", ["attitude", "joints"])
def test_a_cloud_before_the_posture_is_known_does_not_enter_the_map(
    controller: FlipperController, late: str
) -> None:
    """A robot parked on a slope, in frame R level ground, would be taken for level."""
    answer = controller.step(0.0, **posture(0.0, **{late: None}))
    assert answer.fault == f"{late}_missing"
    answer = controller.step(0.05, **posture(0.05, cloud=None))
    assert answer.fault == "cloud_posture"
    assert answer.reason == f"cloud came before any {late}; one before it is allowed"
    assert controller.step(0.1, **posture(0.1)).fault == ""
    slope = math.tan(0.3) * 0.15
    assert np.diff(seen(controller, 0.1)[:6]) == pytest.approx(np.full(5, slope), abs=0.01)


def test_clouds_do_not_enter_the_map_with_an_old_attitude(controller: FlipperController) -> None:
    """While it is lost the robot may tip; by the last attitude level ground would be a slope."""
    now = drive(controller)
    for k in range(12):
        now += 0.05
        answer = controller.step(now, **(tipped if k > 1 else good)(now, attitude=None))
    assert answer.fault == "attitude_age"
    assert controller._intake.refused("cloud").name == "cloud_posture"
    now += 0.05
    assert controller.step(now, **tipped(now)).state == "driving"
    assert np.ptp(seen(controller, now)[6:]) < 0.01  # behind it, the tracks touch the ground
