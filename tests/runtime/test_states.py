"""The robot's states: every transition of the table, their times, and the end of a command."""

import json
import math
import runpy
from pathlib import Path

import pytest

from flipperctl.runtime import CommandWatch, Limits
from flipperctl.runtime.states import DRIVES, TABLE, Event, Fault, State, States

LIMITS = Limits()
TICK = 0.05
GAP = Fault("cloud_age", "cloud is old", gap=True)
VALUE = Fault("joints_value", "joints has front nan")
TILT = Fault("tilt", "roll 1.2 rad", at_once=True)
PAUSE = Fault("pause", "a short one that stops at once", at_once=True, gap=True)
STALL = Fault("stall", "the front flippers do not follow", strike=True)

NEXT = """
            ready    parked   unsure   fault    stop     latch    acknowledge
    waiting driving  standby  waiting  waiting  stopped  stopped  waiting
    standby driving  standby  standby  holding  stopped  latched  standby
    driving driving  standby  driving  holding  stopped  latched  driving
    holding driving  standby  holding  holding  stopped  latched  holding
    stopped driving  standby  stopped  stopped  stopped  latched  waiting
    latched latched  latched  latched  latched  latched  latched  waiting
"""
"""The table of docs/controller.md, written once more by hand."""


class Run:
    """A machine in virtual time, whose belts drive or stand."""

    def __init__(self) -> None:
        self.states, self.now, self.speed = States(LIMITS), 0.0, 0.2
        self.seen: list[State] = []

    def go(self, fault: Fault | None, seconds: float = TICK) -> State:
        """Let time pass with a fault, or without; return the state."""
        for _ in range(round(seconds / TICK)):
            self.now += TICK
            self.states.belts(self.now, self.speed)
            self.seen.append(self.states.update(self.now, fault))
        return self.states.state


def in_state(state: State) -> Run:
    """Return a run in a state, with belts that drive except in standby."""
    run = Run()
    match state:
        case "waiting":
            run.go(GAP)
        case "standby":
            run.speed = 0.0
            run.go(None)
        case "driving":
            run.go(None, 1.0)
        case "holding":
            run.go(None, 1.0)
            run.go(GAP)
        case "stopped":
            run.go(None, 1.0)
            run.go(GAP, 1.5)
        case "latched":
            run.go(None, 1.0)
            run.go(TILT)
    assert run.states.state == state
    return run


@pytest.mark.parametrize(("state", "event"), list(TABLE))
def test_every_transition_is_that_of_the_table(state: State, event: Event) -> None:
    head, *rows = (line.split() for line in NEXT.strip().splitlines())
    expected = {row[0]: dict(zip(head, row[1:], strict=True)) for row in rows}[state][event]
    assert TABLE[state, event] == expected
    run = in_state(state)
    # The event by its inputs, as far as they can lead to it in this state.
    match event:
        case "ready":
            run.speed = 0.2
            run.go(None, 3.0)
        case "parked":
            run.speed = 0.0
            run.go(None, 3.0)
        case "unsure":
            if state not in ("holding", "stopped"):
                return
            run.go(None, 0.3)  # a second fault that ended lately
            run.go(GAP)
            run.go(None)
        case "fault":
            run.go(GAP)
        case "stop":
            if state in ("stopped", "latched"):
                return
            run.go(PAUSE)
        case "latch":
            run.go(TILT)
        case "acknowledge":
            run.states.acknowledge()
    assert run.states.state == expected
    assert (run.states.state in DRIVES) is (expected in ("standby", "driving", "holding"))


def test_a_fault_that_lasts_stops_after_a_second_and_a_gap_ends_after_a_rest() -> None:
    run = in_state("driving")
    assert [run.go(GAP) for _ in range(22)].index("stopped") * TICK == pytest.approx(1.0)
    run.go(GAP, 20.0)
    assert run.go(None, 1.9) == "stopped"
    assert run.go(None, 0.1) == "driving"
    # A second stop soon after lasts, also that of a gap.
    run.go(GAP, 1.2)
    assert run.states.state == "latched"
    assert run.go(None, 60.0) == "latched"
    assert run.states.acknowledge() == "waiting"
    assert run.go(None) == "driving"


def test_faults_while_it_waits_do_not_shorten_the_hold() -> None:
    run = Run()
    run.go(GAP, 2.0)
    run.go(None)
    assert run.go(GAP, 0.95) == "holding"
    assert run.go(GAP, 0.15) == "stopped"


def test_a_gap_long_after_a_stop_is_a_first_one() -> None:
    run = in_state("stopped")
    run.go(None, 2.0 + LIMITS.again)
    assert run.go(GAP, 1.2) == "stopped"


@pytest.mark.parametrize("fault", [VALUE, Fault("inference", "no number")])
def test_what_is_wrong_rather_than_missing_stops_until_it_is_acknowledged(fault: Fault) -> None:
    run = in_state("driving")
    assert run.go(fault, 1.2) == "latched"
    assert run.states.cause is fault
    run.go(TILT)
    assert run.states.cause is fault  # the first one is told


@pytest.mark.parametrize("pause", [0.05, 0.3, 0.5])
def test_faults_that_recur_count_as_one_that_lasts(pause: float) -> None:
    run = in_state("driving")
    begun = run.now
    while run.states.state != "stopped":
        run.go(GAP)
        run.go(None, pause)
        assert run.now - begun < 2.5
    changes = sum(a != b for a, b in zip(run.seen, run.seen[1:], strict=False))
    assert changes <= 5
    for _ in range(200):
        run.go(GAP)
        assert run.go(None, pause) == "stopped"


def test_rare_short_faults_do_not_stop_it() -> None:
    run = in_state("driving")
    for _ in range(50):
        assert run.go(GAP) == "holding"
        assert run.go(None) == "driving"
        run.go(None, 0.75)
    assert "stopped" not in run.seen


def test_a_second_stall_stops() -> None:
    run = in_state("driving")
    assert run.go(STALL, 0.95) == "holding"
    assert run.go(None, 3.0) == "driving"
    assert run.go(STALL) == "latched"


def test_a_parked_robot_that_is_acknowledged_stands_by() -> None:
    run = in_state("latched")
    run.speed = 0.0
    run.go(None, 1.0)
    run.states.acknowledge()
    assert run.states.update(run.now + TICK, None) == "standby"  # before another speed comes


def test_a_robot_that_never_drove_waits_again_after_a_stop() -> None:
    run = Run()
    assert run.go(TILT) == "stopped"
    assert run.go(GAP) == "waiting"
    assert run.go(None) == "driving"


# What drives the motors


def test_a_command_counts_until_it_expires() -> None:
    """As the controller's process is killed: nothing more comes."""
    watch = CommandWatch()
    assert not watch.drives(0.0)
    watch.take(10.0, 10.0, 0.3, True, (0.1, 0.2))
    assert (watch.drives(10.29), watch.angles(10.29)) == (True, (0.1, 0.2))
    assert (watch.drives(10.3), watch.angles(10.3)) == (False, None)


def test_late_old_and_undated_commands_do_not_count_longer() -> None:
    watch = CommandWatch()
    watch.take(10.2, 10.0, 0.3, True, None)  # on its way for 0.2 s
    assert not watch.drives(10.3)
    watch.take(10.3, 9.9, 0.3, True, None)  # overtaken
    watch.take(10.3, math.nan, 0.3, True, None)
    assert not watch.drives(10.31)
    watch.take(10.4, 99.0, 0.3, True, None)  # of a clock that is ahead
    assert watch.drives(10.69)
    assert not watch.drives(10.71)
    watch.take(5.0, 5.0, 0.3, False, None)  # a clock that went back
    assert not watch.drives(5.0)


def test_the_motors_of_the_example_stop_when_the_controller_is_killed() -> None:
    example = runpy.run_path(str(Path(__file__).parents[2] / "examples/messages/motors.py"))
    speeds: list[float] = []
    flippers: list[tuple[float, float] | None] = []
    motors = example["Motors"](speeds.append, flippers.append)
    command = {"valid_for": 0.3, "drive": True, "setpoints": [0.1, 0.2]}
    for tick in range(50):  # 1 s, with a controller that lives for half of it
        now = 0.02 * tick
        if tick < 25:
            motors.receive(now, json.dumps({"time": now, **command}))
        motors.tick(now)
    assert speeds.count(example["SPEED"]) * 0.02 == pytest.approx(0.48 + 0.3, abs=0.021)
    assert (speeds[-1], flippers[-1]) == (0.0, None)
