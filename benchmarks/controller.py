"""Random input for the robot's controller: ``python -m benchmarks.controller [STEPS]``.

In: ages, jumps of the clock, frames, numbers and clouds of any kind, sound ones among them. Out:
how often each answer came; any exception ends the command.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.runtime import (
    Attitude,
    Cloud,
    FlipperController,
    JointAngles,
    Mount,
    Odometry,
    RobotSetup,
)

STEPS = 1_000_000
_ODD: tuple[Any, ...] = (math.nan, math.inf, -math.inf, None, "1", 1e300, -40.0, [], object())
_CLOUDS: tuple[Any, ...] = (
    None,
    "points",
    [],
    np.zeros((0, 3)),
    np.full((50, 3), np.nan),
    np.zeros((5, 2)),
    [[1]],
)
SETUP = RobotSetup(cloud_frame="base_link", mount=Mount(0.0, 0.0, math.pi / 2, 0.0, 0.05))


class Garbage:
    """Draws times and messages; with each chance of ``odd`` one part is wrong."""

    def __init__(self, seed: int, odd: float = 0.04) -> None:
        self._rng = np.random.default_rng(seed)
        self._odd, self._now = odd, 0.0
        x, y = np.meshgrid(np.linspace(-1.0, 1.5, 26), np.linspace(-0.35, 0.35, 7))
        self._level = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -0.1)])

    def draw(self) -> tuple[float, dict[str, object]]:
        """Return a time and the messages of one step."""
        self._now += self._value(0.05)
        if self._rng.random() < self._odd / 8:
            self._now += float(self._rng.choice([-3.0, -0.2, 0.5, 5.0]))
        now = self._now
        if self._rng.random() < self._odd / 4:
            return float(self._rng.choice([math.nan, math.inf, -math.inf])), {}
        tilt = 1.0 if self._is_odd() else 0.1  # mostly a robot that still sees the ground
        messages: dict[str, object] = {
            "joints": JointAngles(self._stamp(), self._number(0.5), self._number(0.5)),
            "attitude": Attitude(
                self._stamp(),
                self._frame(),
                self._number(0.2 * tilt),
                self._number(0.5 * tilt),
                self._number(0.3),
            ),
            "odometry": Odometry(self._stamp(), self._number(0.3)),
        }
        if self._rng.random() < 0.2:
            messages["cloud"] = Cloud(self._stamp(), self._frame(), self._points())
        if self._is_odd():
            messages[str(self._rng.choice(list(messages)))] = self._pick(_ODD)
        return now, messages

    def _is_odd(self) -> bool:
        return bool(self._rng.random() < self._odd)

    def _pick(self, values: tuple[Any, ...]) -> Any:
        return values[self._rng.integers(len(values))]

    def _value(self, scale: float) -> float:
        return float(scale * self._rng.random())

    def _number(self, scale: float) -> Any:
        if self._is_odd():
            return self._pick(_ODD)
        return float(scale * self._rng.uniform(-1, 1))

    def _stamp(self) -> float:
        if self._is_odd():
            return self._now + float(self._rng.choice([-5.0, 0.2, math.nan]))
        return self._now - self._value(0.02)

    def _frame(self) -> str:
        return "map" if self._is_odd() else "base_link"

    def _points(self) -> Any:
        if self._is_odd():
            return self._pick(_CLOUDS)
        points = self._level + 0.02 * self._rng.standard_normal(self._level.shape)
        points[self._rng.random(len(points)) < self._value(0.2)] = math.nan
        return points


def main(path: Path, steps: int = STEPS) -> int:
    """Step the controller with random input; print how often each fault was answered."""
    controller, garbage = FlipperController(path, SETUP), Garbage(1)
    limit = math.pi + 1e-9  # a hold may lie beyond the limits of the policy
    answers: Counter[str] = Counter()
    decisions, begun = 0, time.thread_time()
    for step in range(steps):
        now, messages = garbage.draw()
        if step % 20 == 0:
            controller.acknowledge()
        answer = controller.step(now, **messages)  # type: ignore[arg-type]  # garbage on purpose
        targets = answer.targets or (0.0, 0.0)
        told = bool(answer.reason) is bool(answer.fault or answer.state == "standby")
        moves = answer.targets is not None and answer.state in ("waiting", "standby")
        if max(map(abs, targets)) > limit or not told or moves:
            print(f"not safe at {now}: {answer}")
            return 1
        answers[answer.fault or answer.state] += 1
        decisions += answer.action is not None
    spent = time.thread_time() - begun
    print(
        f"{steps} steps, {decisions} decisions, no exception, "
        f"every target within ±{limit:.3f} rad\n"
        f"{spent:.1f} s of computing, {steps / spent:.0f} steps/s; a million takes "
        f"{1e6 * spent / steps / 60:.1f} min"
    )
    for name, count in answers.most_common():
        print(f"{name:18}{count:9}")
    return 0


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        print("python -m benchmarks.controller POLICY.onnx [STEPS]")
        sys.exit(2)
    sys.exit(main(Path(sys.argv[1]), *map(int, sys.argv[2:])))
