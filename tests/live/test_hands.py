"""Messages of the driving page, and the commands that they lead to."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flipperctl.api import Robot, RobotState
from flipperctl.live import hands
from flipperctl.live.hands import Asked, Hands, parse

PERIOD = 0.05
ROBOT = Robot()
STEP = ROBOT.angle_step
PAIRS, STILL = ("front", "rear"), (0, 0)


def state(front: float = 0.0, rear: float = 0.0) -> RobotState:
    return RobotState(
        position=np.zeros(2), pitch=0.0, front=front, rear=rear, velocity=np.zeros(2),
        pitch_rate=0.0, time=0.0,
    )  # fmt: skip


def asked(**values: Any) -> Asked:
    rates, steps = ([values.pop(n + kind, 0) for n in PAIRS] for kind in ("", "_steps"))
    plain = {"kind": "hands", "at": 1.0, "belts": 0, "rates": rates, "steps": steps}
    found = parse(json.dumps({**plain, **values}))
    assert isinstance(found, Asked)
    return found


def test_a_press_is_a_step_and_counts_once() -> None:
    h = Hands(ROBOT, PERIOD)
    h.hear(asked(front_steps=7, belts=1))  # of an earlier episode
    command, at = h.command((0.0, 0.0), state(), STILL)
    assert (command.front, command.rear, command.belts, at) == (0.0, 0.0, 1.0, 1.0)
    h.hear(asked(front_steps=8, rear_steps=-1, at=2.0))
    command, at = h.command((0.0, 0.0), state(), STILL)
    assert (command.front, command.rear) == pytest.approx((STEP, -STEP))
    assert at == 2.0
    again, _ = h.command((command.front, command.rear), state(), STILL)
    assert again.front == command.front


def test_a_held_key_turns_at_the_speed_of_the_flippers() -> None:
    h = Hands(ROBOT, PERIOD)
    h.hear(asked(front=1, rear=-0.5))
    targets = 0.1, 0.1
    command, _ = h.command(targets, state(*targets), STILL)
    assert command.front == pytest.approx(0.1 + ROBOT.flipper_speed * PERIOD)
    assert command.rear == pytest.approx(0.1 - ROBOT.flipper_speed * PERIOD / 2)


def test_targets_stay_near_the_flipper_and_within_its_limits() -> None:
    h = Hands(ROBOT, PERIOD)
    h.hear(asked())
    h.command((0.0, 0.0), state(), STILL)
    h.hear(asked(front_steps=3, rear_steps=-30))
    command, _ = h.command((0.0, 0.0), state(), STILL)
    assert command.front == pytest.approx(3 * STEP)
    assert command.rear == -ROBOT.angle_limit
    h.hear(asked(front_steps=4))
    blocked, _ = h.command((command.front, 0.0), state(), STILL)  # the flipper has not moved
    assert blocked.front == pytest.approx(2 * STEP)


def test_without_news_everything_is_held(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 10.0
    monkeypatch.setattr("flipperctl.live.hands.time.monotonic", lambda: now)
    h = Hands(ROBOT, PERIOD)
    held, at = h.command((0.5, 0.0), state(0.2), STILL)
    assert (held.front, held.belts, at) == (0.2, 0.0, None)
    h.hear(asked(belts=1))
    assert h.command((0.5, 0.0), state(0.2), STILL)[0].belts == 1.0
    now += hands.LOST + 0.01
    held, at = h.command((0.5, 0.0), state(0.3), STILL)
    assert (held.front, held.belts, at) == (0.3, 0.0, None)
    sagging, _ = h.command((0.3, 0.0), state(0.28), STILL)
    assert sagging.front == 0.3  # not the angle to which its load turned it
    h.hear(asked(front_steps=5, belts=1))  # pressed while nobody heard it
    assert h.command((0.3, 0.0), state(0.3), STILL)[0].front == pytest.approx(0.3)
    h.leave()
    assert not h.present
    assert h.command((0.3, 0.0), state(0.3), STILL)[0].belts == 0.0


def test_a_policy_turns_what_the_operator_leaves() -> None:
    h = Hands(ROBOT, PERIOD, helped=True)
    h.hear(asked(belts=1))
    command, _ = h.command((0.0, 0.0), state(), (1, -1))
    assert [*command.numbers] == pytest.approx([STEP, -STEP, 1.0, 0.0, 0.0])
    h.hear(asked(rear_steps=1))
    command, _ = h.command((0.0, 0.0), state(), (1, -1))
    assert [*command.numbers] == pytest.approx([STEP, STEP, 0.0, 0.0, 1.0])
    h.hear(asked(rear_steps=1))
    assert h.command((0.0, 0.0), state(), (0, -1))[0].rear == 0.0  # still the operator's
    h.release()
    assert h.command((0.0, 0.0), state(), (0, -1))[0].rear == pytest.approx(-STEP)


def test_of_four_each_flipper_turns_alone_and_who_turns_it_has_the_pair() -> None:
    h = Hands(Robot(flippers="four"), PERIOD, helped=True)
    with pytest.raises(ValueError, match="of 4 joints"):
        h.hear(asked())  # of a page that drives pairs
    first, level = (
        asked(rates=[0, 0, 0, 0], steps=[0, 0, 0, 0]),
        replace(state(), flippers=(0.0,) * 4),
    )
    h.hear(first)
    h.command((0.0,) * 4, level, (0,) * 4)
    h.hear(first.model_copy(update={"steps": (1, 0, 0, 0)}))
    command, _ = h.command((0.0,) * 4, level, (1, 1, 1, -1))
    assert command.flippers == pytest.approx((STEP, 0.0, STEP, -STEP))
    assert [*command[:5]] == pytest.approx([STEP / 2, 0.0, 0.0, 1.0, 0.0])


@pytest.mark.parametrize(
    "message",
    [
        "",
        "[]",
        '{"kind": "fire"}',
        '{"kind": "do", "what": "explode"}',
        '{"kind": "do", "what": "begin", "also": 1}',
        '{"kind": "answers", "values": [1, 2, 3]}',
        '{"kind": "answers", "values": [1, 2, 3, 4, 5, 101]}',
        *(
            json.dumps({"kind": "hands", "at": 1, "rates": [0, 0], "belts": 0,
                        "steps": [0, 0]} | wrong)
            for wrong in (
                {"rates": [2, 0]}, {"belts": "1"}, {"rates": [0, None]}, {"steps": [1.5, 0]},
                {"at": -1}, {"belts": math.inf}, {"belts": math.nan}, {"steps": [0, 10**9]},
                {"x": 1}, {"rates": [0]}, {"steps": [0] * 5},
            )
        ),
        "[" * 100_000,
    ],
)  # fmt: skip
def test_no_other_message_is_taken(message: str) -> None:
    with pytest.raises(ValueError):
        parse(message)
