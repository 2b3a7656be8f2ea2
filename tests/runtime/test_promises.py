"""Each promise of docs/controller.md, broken on purpose, on a robot in virtual time."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flipperctl.runtime import FlipperController, RobotSetup
from tests.runtime.linear import ROBOT, RULE, write
from tests.runtime.robot import (
    RATES,
    SETUP,
    TICK,
    TURN,
    Robot,
    changes,
    faults,
    first,
    joint_angles,
    turned,
)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy that turns its flippers at nearly each decision, by the noise of the ground."""
    return write(tmp_path_factory.mktemp("policy") / "p.onnx", robot=ROBOT, targets=RULE)


@pytest.fixture
def build(file: Path) -> Callable[..., Robot]:
    def robot(setup: RobotSetup = SETUP, shadow: bool = False, **settings: Any) -> Robot:
        return Robot(FlipperController(file, setup, shadow=shadow), **settings)

    return robot


def changing(device: str, **fields: Any) -> Callable[[str, dict[str, Any]], None]:
    """Return a mutation: functions of the fields' values, or values."""

    def change(name: str, message: dict[str, Any]) -> None:
        if name == device:
            for key, value in fields.items():
                message[key] = value(message[key]) if callable(value) else value

    return change


def repeating(device: str, *fields: str) -> Callable[[str, dict[str, Any]], None]:
    """Return a mutation that repeats the first values of fields under new stamps."""
    before: dict[str, Any] = {}

    def change(name: str, message: dict[str, Any]) -> None:
        if name == device:
            for key in fields:
                message[key] = before.setdefault(key, message[key])

    return change


def joints(message: dict[str, Any]) -> list[list[float]]:
    """Return the angles of the left and the right joint of both pairs."""
    pairs = zip((message["front"], message["rear"]), message["offsets"], strict=True)
    return [[angle + off for off in pair] for angle, pair in pairs]


def scaled(factor: float, *, front_only: bool = False, right_only: bool = False) -> Any:
    """Return a mutation of the joints: angles times a factor."""

    def change(name: str, message: dict[str, Any]) -> None:
        if name != "joints":
            return
        rear = 1.0 if front_only else factor
        left = (1.0, 1.0) if right_only else (factor, rear)
        (a, b), (c, d) = joints(message)
        message |= joint_angles((left[0] * a, factor * b), (left[1] * c, rear * d))

    return change


def of_pairs(change: Any) -> Any:
    def both(name: str, message: dict[str, Any]) -> None:
        change(name, message)
        if name == "joints":
            message["offsets"] = None

    return both


# What works


@pytest.mark.parametrize("ground", ["flat", "step", "stairs"])
@pytest.mark.parametrize("obeys", ["targets", "setpoints"])
def test_it_drives_without_a_fault(build: Any, ground: str, obeys: str) -> None:
    moments = build(ground=ground, obeys=obeys).run(7.0)
    assert faults(moments[25:]) == set()
    assert moments[-1].x > 1.2
    assert sum(m.answer.action is not None for m in moments) >= 10
    assert turned(moments) > 0.2
    assert changes(moments[25:]) == 0


def test_a_restart_goes_on_and_shadow_mode_only_tells(build: Any, file: Path) -> None:
    robot = build()
    robot.run(2.0)
    robot.controller = FlipperController(file, SETUP)
    assert robot.run(2.0)[-1].answer.state == "driving"
    watcher = build(shadow=True, turns=(0.0, 0.0))  # someone else drives, and turns nothing
    moments = watcher.run(4.0)
    assert faults(moments[25:]) == set()
    assert any(m.answer.action is not None for m in moments)


@pytest.mark.parametrize("noisy", [True, False])
def test_a_parked_robot_neither_moves_nor_changes(build: Any, noisy: bool) -> None:
    """Without noise all its messages repeat."""
    robot = build(parked=True, noise=0.004 if noisy else 0.0)
    if not noisy:
        robot.rng = type("Still", (), {"normal": lambda self, *a, size=9: np.zeros(size)})()
    moments = robot.run(4.0)
    assert {m.answer.state for m in moments[12:]} == {"standby"}  # from the first cloud on
    assert {m.answer.targets for m in moments} == {None}
    if not noisy:
        return
    robot.parked = False
    robot.run(2.0)
    robot.parked = True
    moments = robot.run(2.0)
    assert first(moments, "standby") == pytest.approx(0.5, abs=0.05)
    assert changes(moments) == 1


# Messages that do not come, or are wrong

GAPS = {"attitude": 0.1, "joints": 0.1, "odometry": 0.3, "cloud": 0.5}


@pytest.mark.parametrize(("device", "age"), GAPS.items())
def test_a_device_that_falls_silent_stops_it_and_back_it_goes_on(
    build: Any, device: str, age: float
) -> None:
    robot = build()
    robot.run(1.2)
    gone = robot.run(2.5, drop=(device,))
    assert faults(gone) == {f"{device}_age"}
    assert first(gone, "holding") == pytest.approx(age, abs=0.2 if device == "cloud" else 0.05)
    assert first(gone, "stopped") - first(gone, "holding") == pytest.approx(1.0, abs=0.03)
    back = robot.run(3.0)
    assert sum(not m.runs for m in back) * 0.02 == pytest.approx(2.0, abs=0.3)  # it stands
    assert back[-1].answer.state == "driving"


NAN = float("nan")
WRONG = {
    "joints nan": ("joints_value", changing("joints", front=NAN)),
    "joints text": ("joints_value", changing("joints", front="x")),
    "joints none": ("joints_value", changing("joints", rear=None)),
    "joints offsets": ("joints_value", changing("joints", offsets="left")),
    "attitude nan": ("attitude_value", changing("attitude", pitch=NAN)),
    "odometry nan": ("odometry_value", changing("odometry", speed=NAN)),
    "cloud nan": ("cloud_points", changing("cloud", points=lambda p: p * NAN)),
    "cloud of 5": ("cloud_points", changing("cloud", points=lambda p: p[:5])),
    "cloud of another frame": ("cloud_frame", changing("cloud", frame="velodyne")),
    "cloud ahead": ("cloud_stamp", changing("cloud", time=lambda t: t + 3600)),
    "belts in mm/s": ("odometry_value", changing("odometry", speed=lambda v: 1000 * v)),
    "tilt": ("tilt", changing("attitude", pitch=1.1)),
    "attitude in degrees": ("tilt", changing("attitude", pitch=lambda p: p + 1.0)),
}


@pytest.mark.parametrize(("fault", "change"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_ends_in_one_stop_until_it_is_acknowledged(
    build: Any, fault: str, change: Any
) -> None:
    robot = build()
    robot.run(1.2)
    bad = robot.run(3.0, change)
    assert faults(bad) == {fault}
    assert changes(bad) <= 2
    assert bad[-1].answer.latched
    good = robot.run(2.2)
    assert not any(m.runs for m in good)
    robot.controller.acknowledge()
    assert robot.run(1.0)[-1].answer.state == "driving"


def test_belts_in_millimetres_from_the_start_end_in_one_stop(build: Any) -> None:
    robot = build()
    moments = robot.run(12.0, changing("odometry", speed=lambda v: 1000 * v))
    assert moments[-1].answer.latched
    assert changes(moments) <= 5
    assert sum(m.runs for m in moments) * 0.02 < 2.0
    assert moments[-1].x < 0.4


def test_a_cloud_in_millimetres_never_drives(build: Any) -> None:
    moments = build().run(3.0, changing("cloud", points=lambda p: 1000 * p))
    assert not any(m.runs for m in moments)
    assert "coverage" in faults(moments)


def test_stamps_that_stand_still_count_as_silence(build: Any) -> None:
    robot = build()
    robot.run(2.0)
    moments = robot.run(2.0, lambda device, message: message.update(time=2.0))
    assert first(moments, "holding") < 0.15
    assert moments[-1].answer.state == "stopped"


@pytest.mark.parametrize("jump", [5.0, -5.0, 3600.0, 2.0])
@pytest.mark.parametrize("stamps", [True, False])
def test_a_clock_that_jumps_stops_at_once_until_it_is_acknowledged(
    build: Any, jump: float, stamps: bool
) -> None:
    robot = build()
    robot.run(1.2)

    def late(device: str, message: dict[str, Any]) -> None:
        message["time"] += jump if stamps else 0.0

    moments = robot.run(1.0, late, clock=lambda time: time + jump)
    assert {(m.answer.fault, m.answer.latched, m.runs) for m in moments} == {
        ("clock_jump", True, False)
    }
    robot.controller.acknowledge()
    after = robot.run(1.0, late, clock=lambda time: time + jump)
    assert after[-1].runs is stamps


def test_messages_of_before_a_reset_are_ignored_until_its_clock_begins(build: Any) -> None:
    """As of the last simulated episode, on their way while the node is told of the next."""
    robot = build()
    robot.run(2.0)
    robot.controller.reset(since=1000.0)
    late = robot.run(0.5)
    assert {m.answer.state for m in late} == {"waiting"}

    def shifted(device: str, message: dict[str, Any]) -> None:
        message["time"] += 1000.0

    moments = robot.run(1.0, shifted, clock=lambda time: time + 1000.0)
    assert "clock_jump" not in faults(moments)
    assert moments[-1].answer.state == "driving"


def test_a_driver_that_sleeps_holds(build: Any) -> None:
    robot = build()
    robot.run(2.0)
    robot.now += 0.9
    moments = robot.run(1.0)
    assert faults(moments) <= {"cloud_age", "joints_age", "cloud_posture"}
    assert moments[-1].answer.state == "driving"


# Gaps that are short, and that recur


def test_a_short_gap_keeps_targets_and_memory(build: Any) -> None:
    smooth, robot = build(ground="step"), build(ground="step")
    resets: list[None] = []
    robot.run(1.0)
    reset = robot.controller.policy.reset
    robot.controller.policy.reset = lambda: (resets.append(None), reset())
    for _ in range(8):
        gap = robot.run(0.16, drop=("joints",))
        assert faults(gap) == {"joints_age"}
        assert {m.answer.targets for m in gap if not m.answer.action} - {None}
        robot.run(0.64)
    assert resets == []
    assert all(m.runs for m in robot.trace[50:])
    assert len(smooth.run(1.0)) == 50


@pytest.mark.parametrize("rate", [7, 5, 2])
def test_a_device_that_is_too_slow_stops_the_belts(build: Any, rate: int) -> None:
    robot = build()
    robot.run(2.0)
    begun = len(robot.trace)
    for _ in range(6 * rate):
        robot.run(0.02)
        robot.run(1 / rate - 0.02, drop=("joints",))
    moments = robot.trace[begun:]
    assert changes(moments) <= 6
    assert not any(m.runs for m in moments[150:])
    assert moments[-1].answer.state == "stopped"


# Whether it moves as told


UNLIKE = {
    "degrees": scaled(math.degrees(1)),
    "degrees and signs": scaled(-math.degrees(1)),
    "degrees of pairs": of_pairs(scaled(math.degrees(1))),
    "both signs": scaled(-1),
    "front sign": scaled(-1, front_only=True),
    "sign of pairs": of_pairs(scaled(-1)),
    "right sign": scaled(-1, right_only=True),
}


@pytest.mark.parametrize("change", UNLIKE.values(), ids=UNLIKE)
@pytest.mark.parametrize(("obeys", "rate"), [("targets", 20), ("setpoints", 50)])
def test_no_flipper_turns_by_a_tenth_of_a_radian_with_a_wrong_sign_or_unit(
    build: Any, monkeypatch: pytest.MonkeyPatch, change: Any, obeys: str, rate: int
) -> None:
    """In degrees 0.05 rad is just below the π that is allowed, and soon beyond it."""
    monkeypatch.setitem(RATES, "joints", rate)
    for raised in (0.0, 0.05, 0.2, 0.3, 0.6, -0.5):
        robot = build(obeys=obeys, angles=[raised, raised, -raised, -raised])
        moments = robot.run_until_latched(1.6, change)
        named = {"motion_sign", "motion_scale", "motion_sides", "joints_value", "joints_pair"}
        assert faults(moments) & named, raised
        assert turned(moments) <= 0.08, raised
        assert not moments[-1].runs


@pytest.mark.parametrize("slow", [0.2, 0.05, 0.02])
def test_slow_flippers_are_told_by_name(build: Any, slow: float) -> None:
    moments = build(turns=(slow, 1.0)).run_until_latched(14.0, lambda *message: None)
    assert "motion_slow" in faults(moments)
    assert moments[-1].answer.latched


@pytest.mark.parametrize("kind", ["blocked", "encoder"])
def test_flippers_that_do_not_follow_stall_and_then_stop(build: Any, kind: str) -> None:
    robot = build()
    robot.run(2.0)
    robot.turns = (0.0 if kind == "blocked" else 1.0, 1.0)
    frozen = repeating("joints", "front", "offsets") if kind == "encoder" else lambda *message: None
    moments = robot.run_until_latched(14.0, frozen)
    assert faults(moments) <= {"stall", "motion_slow"}
    assert moments[-1].answer.latched


def pushed(robot: Robot, seconds: float, rate: float, *, by_driving: bool) -> list[Any]:
    """Raise the front pair at ``rate`` per flipper speed against its motor, and let time pass."""
    moments = []
    for _ in range(round(seconds / TICK)):
        if robot.runs or not by_driving:
            robot.angles[:2] = [angle + (1 + rate) * TURN * TICK for angle in robot.angles[:2]]
        moments += robot.run(TICK)
    return moments


@pytest.mark.parametrize(
    ("seconds", "rate", "named"),
    [(0.2, 4.0, set()), (0.4, 1.0, set()), (3.0, 1.0, {"motion_away"})],
    ids=["a fall", "short", "long"],
)
def test_a_load_on_flippers_that_have_obeyed_is_no_fault_or_a_short_hold(
    build: Any, seconds: float, rate: float, named: set[str]
) -> None:
    """It may be as fast as the motors or faster, but it ends as the belts stand."""
    robot = build()
    robot.run(3.0)
    moments = pushed(robot, seconds, rate, by_driving=True) + robot.run(3.0)
    assert turned(moments) > 0.14
    assert faults(moments) == named
    assert sum(m.runs for m in moments[-50:]) == 50
    assert moments[-1].answer.state == "driving"


@pytest.mark.parametrize(("rate", "seconds"), [(1.0, 0.8), (0.5, 1.2), (0.3, 3.5)])
def test_flippers_that_run_away_stop_the_robot_until_it_is_acknowledged(
    build: Any, rate: float, seconds: float
) -> None:
    """The belts stand within ``seconds``, and for good a second later."""
    robot = build()
    robot.run(3.0)
    moments = pushed(robot, 5.0, rate, by_driving=False)
    stood = next(m for m in moments if not m.runs)
    stopped = next(m for m in moments if m.answer.latched)
    assert stood.time - moments[0].time < seconds
    assert stopped.time - stood.time < 1.0
    assert stopped.answer.fault == moments[-1].answer.fault == "motion_runaway"
    assert max(stopped.angles) - max(moments[0].angles) < 0.5
    assert not any(m.runs for m in moments[moments.index(stopped) :])


def test_flippers_beyond_the_limits_are_held_there_and_turned_back_by_decisions(build: Any) -> None:
    robot = build(angles=[1.5, 1.5, -1.5, -1.5], parked=True)
    robot.run(1.0)
    robot.parked = False
    robot.run(1.0)
    gone = robot.run(2.0, drop=("cloud",))
    assert turned(gone[40:]) < 0.01
    robot.run(6.0)
    assert max(map(abs, robot.angles)) < 1.1


def test_left_and_right_angles_may_come_now_and_then(build: Any) -> None:
    count = [0]

    def some(device: str, message: dict[str, Any]) -> None:
        if device == "joints":
            count[0] += 1
            message["offsets"] = message["offsets"] if count[0] % 3 else None

    assert faults(build().run(4.0, some)[25:]) == set()


# Nothing new


def test_a_hung_lidar_ages(build: Any) -> None:
    robot = build(ground="step")
    robot.run(2.0)
    moments = robot.run(6.0, repeating("cloud", "points"))
    assert faults(moments) == {"cloud_age"}
    assert changes(moments) == 2
    assert "all its numbers repeat" in moments[-1].answer.reason


def test_a_frozen_attitude_ages(build: Any) -> None:
    robot = build()
    robot.run(2.0)
    moments = robot.run(4.0, repeating("attitude", "roll", "pitch"))
    assert faults(moments) <= {"attitude_age", "cloud_posture"}
    assert first(moments, "stopped") < 1.3


def test_the_attitude_of_a_simulator_without_noise_may_repeat(build: Any) -> None:
    moments = build().run(4.0, changing("attitude", roll=0.0, pitch=0.0))
    assert faults(moments[45:]) == set()


# What nothing contradicts is not noticed


def wall(device: str, message: dict[str, Any]) -> None:
    """Put a wall 0.8 m ahead that follows the robot."""
    if device == "cloud":
        y, z = np.meshgrid(np.linspace(-0.3, 0.3, 30), np.linspace(-0.1, 0.5, 30))
        ahead = np.column_stack([np.full(y.size, 0.8), y.ravel(), z.ravel()])
        message["points"] = np.concatenate([message["points"], ahead])


@pytest.mark.parametrize(
    "change",
    [
        changing("cloud", points=lambda p: np.add(p, [0.0, 0.0, 0.25])),
        wall,
        changing("attitude", time=lambda t: t - 0.06),
        changing("attitude", pitch=lambda p: p + 0.15),
    ],
    ids=["high clouds", "ghost wall", "late attitudes", "tilted unit"],
)
@pytest.mark.parametrize("begun", [0.0, 2.0])
def test_wrong_maps_and_late_attitudes_are_no_faults(build: Any, change: Any, begun: float) -> None:
    robot = build()
    robot.run(begun)
    moments = robot.run(3.0, change)
    assert faults(moments[25:]) == set()
    assert moments[-1].answer.state == "driving"


# Odometry


def test_an_odometry_that_stands_or_is_absent(build: Any) -> None:
    robot = build()
    robot.run(2.0)
    moments = robot.run(2.0, changing("odometry", speed=0.0))
    assert moments[-1].answer.state == "standby"
    bare = build()
    moments = bare.run(4.0, drop=("odometry",))
    assert moments[-1].answer.state == "driving"
    assert faults(moments[20:]) == set()
