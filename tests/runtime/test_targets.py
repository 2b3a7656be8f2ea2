"""How an action turns the flippers, on the robot as in the environment."""

import math
from pathlib import Path

import pytest

from flipperctl.errors import NonFiniteError, PolicyError
from flipperctl.runtime import OnnxPolicy, TargetRule
from tests.runtime.linear import STEP, write

RULE = TargetRule(window=0.25, limit=1.0)
STATED = {"meaning": "x", "window": 0.25, "limit": 1.0}


@pytest.mark.parametrize(
    ("last", "measured", "turn", "expected"),
    [
        (0.5, 0.5, 0.25, 0.75),
        (0.5, 0.47, 0.25, 0.75),  # it follows: its target keeps the grid of angles
        (0.5, 0.25, 0.25, 0.75),  # as far behind as is allowed
        (0.5, 0.125, 0.25, 0.625),  # blocked: 0.125 + 0.25 is turned by 0.25
        (0.625, 0.125, 0.0, 0.375),  # a command to hold keeps one window of it
        (0.625, 0.125, -0.25, 0.125),  # the opposite command stops pushing at once
        (-0.5, 0.0, -0.25, -0.5),
        (0.9, 0.95, 0.25, 1.0),  # the limit
        (-0.9, -1.3, 0.0, -1.0),  # a flipper that was pushed past the limit
    ],
)
def test_a_target_stays_near_the_measured_angle(
    last: float, measured: float, turn: float, expected: float
) -> None:
    found = RULE.next_targets((last, -last), (measured, -measured), (turn, -turn))
    assert found == pytest.approx((expected, -expected))


def test_a_blocked_pair_as_the_page_about_robots_describes_it() -> None:
    rule = TargetRule(window=15.0, limit=60.0)  # in degrees, with the front pair held at 3°
    found, target = [], 0.0
    for turn in (15.0, 15.0, 15.0, 15.0, -15.0):
        target, _ = rule.next_targets((target, 0.0), (3.0 if found else 0.0, 0.0), (turn, 0.0))
        found.append(target)
    assert found == [15.0, 30.0, 33.0, 33.0, 3.0]


def test_the_robot_turns_its_flippers_by_the_rule_of_its_policy(tmp_path: Path) -> None:
    policy = OnnxPolicy(write(tmp_path / "p.onnx", targets=STATED))
    assert policy.interface.targets == RULE
    # action 2: front down, rear up, each by 15°
    found = policy.next_targets([0.5, 0.0], [0.125, 0.0], 2)
    assert found.tolist() == pytest.approx([0.375 - STEP, STEP])


@pytest.mark.parametrize("stated", [{}, {"window": 0.25}, {**STATED, "window": 0}, "free", [1, 2]])
def test_a_wrong_rule_is_refused(stated: object, tmp_path: Path) -> None:
    path = write(tmp_path / "p.onnx", targets=stated)
    with pytest.raises(PolicyError, match=r"flipperctl\.targets is .*window and limit"):
        OnnxPolicy(path)


@pytest.mark.parametrize(
    ("targets", "angles", "action", "error", "text"),
    [
        ([0.0], [0.0, 0.0], 4, PolicyError, r"targets have shape \(1,\); \(2,\) is allowed"),
        ([0.0, 0.0], ["x", 0.0], 4, PolicyError, "angles are not numbers"),
        ([0.0, 0.0], [math.nan, 0.0], 4, NonFiniteError, "angles are .*nan"),
        ([0.0, 0.0], [45.0, 0.0], 4, PolicyError, r"angles are \[45\.  0\.\] rad; ±π is allowed"),
        ([0.0, 0.0], [0.0, 0.0], 9, PolicyError, "no action 9; a whole number from 0 to 8 is"),
        ([0.0, 0.0], [0.0, 0.0], -1, PolicyError, "no action -1"),
        ([0.0, 0.0], [0.0, 0.0], 1.5, PolicyError, "no action 1.5; a whole number"),
        ([0.0, 0.0], [0.0, 0.0], None, PolicyError, "no action None"),
        ([0.0, 0.0], [0.0, 0.0], "4", PolicyError, "no action 4; a whole number"),
    ],
)
def test_wrong_arguments_are_refused(
    targets: list, angles: list, action: int, error: type, text: str, tmp_path: Path
) -> None:
    policy = OnnxPolicy(write(tmp_path / "p.onnx", targets=STATED))
    with pytest.raises(error, match=text):
        policy.next_targets(targets, angles, action)
