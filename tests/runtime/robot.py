"""A small tracked robot in virtual time, its devices, and a driver that obeys the controller."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from flipperctl.runtime import (
    Answer,
    Attitude,
    Cloud,
    FlipperController,
    JointAngles,
    Mount,
    Odometry,
    RobotSetup,
)

SETUP = RobotSetup(cloud_frame="base_link", mount=Mount(0.0, 0.0, math.pi / 2, 0.0, 0.05))
KINDS = {"attitude": Attitude, "joints": JointAngles, "odometry": Odometry, "cloud": Cloud}
RATES = {"attitude": 50, "joints": 50, "odometry": 50, "cloud": 5}
"""Messages of the devices [1/s]."""
TICK = 0.02
SPEED, TURN, HALF = 0.2, 0.436, 0.28
"""Speed of the belts [m/s] and the flippers [rad/s]; half the distance of the hinges [m]."""
GROUNDS = {
    "flat": ([-9.0, 9.0], [0.0, 0.0]),
    "step": ([-9.0, 0.6, 0.7, 9.0], [0.0, 0.0, 0.12, 0.12]),
    "stairs": ([-9.0, 0.6, 0.7, 1.0, 1.1, 9.0], [0.0, 0.0, 0.12, 0.12, 0.24, 0.24]),
}
Mutation = Callable[[str, dict[str, Any]], None]
"""Changes the fields of a device's message while a fault is on."""


@dataclass
class Moment:
    """What one step told, and where the robot was then."""

    time: float
    answer: Answer
    x: float
    angles: tuple[float, ...]
    """Of front left, front right, rear left and rear right [rad]."""
    runs: bool
    """Whether the belts run."""


def joint_angles(*joints: tuple[float, float]) -> dict[str, Any]:
    """Return the numbers of ``JointAngles`` of the left and right joints of both pairs."""
    front, rear = (sum(pair) / 2 for pair in joints)
    means = zip((front, rear), joints, strict=True)
    offsets = tuple(tuple(a - mean for a in pair) for mean, pair in means)
    return {"front": front, "rear": rear, "offsets": offsets}


@dataclass
class Robot:
    """Rests with both hinges on the ground, whatever its flippers do, and turns these as told."""

    controller: FlipperController
    ground: str = "flat"
    angles: list[float] = field(default_factory=lambda: [0.1, 0.1, -0.1, -0.1])
    obeys: str = "targets"
    """Which angles its driver obeys; its own speed is that of the training."""
    turns: tuple[float, float] = (1.0, 1.0)
    """Factors of the speed of the front and the rear flippers."""
    parked: bool = False
    """Whether the operator stands, although the belts may run."""
    noise: float = 0.004

    def __post_init__(self) -> None:
        self.now, self.x, self.runs = 0.0, 0.0, False
        self.rng = np.random.default_rng(1)
        self.goal: list[float] | None = None
        self.trace: list[Moment] = []
        lane = np.linspace(-1.2, 1.6, 57)
        self.lane = np.column_stack([np.repeat(lane, 7), np.tile(np.linspace(-0.3, 0.3, 7), 57)])

    def height(self, x: Any) -> Any:
        return np.interp(x, *GROUNDS[self.ground])

    def messages(self) -> dict[str, dict[str, Any]]:
        """Return what the devices measure now, with noise, as a driver would send it."""
        rear, front = self.height(self.x - HALF), self.height(self.x + HALF)
        pitch, middle = math.atan2(front - rear, 2 * HALF), (front + rear) / 2 + 0.1
        due = [
            k for k, rate in RATES.items() if round(self.now / TICK) % round(1 / TICK / rate) == 0
        ]
        measured: dict[str, dict[str, Any]] = {}
        jitter = self.rng.normal(0, 1, 9)
        if "cloud" in due:
            x = self.lane[:, 0]
            z = self.height(self.x + x) - middle + 0.004 * self.rng.normal(size=len(x))
            cos, sin = math.cos(pitch), math.sin(pitch)
            points = np.column_stack([cos * x + sin * z, self.lane[:, 1], cos * z - sin * x])
            measured["cloud"] = {"frame": "base_link", "points": points}
        if "attitude" in due:
            tilt = {"roll": 0.003 * jitter[0], "pitch": pitch + 0.003 * jitter[1]}
            measured["attitude"] = {"frame": "base_link", **tilt, "yaw_rate": 0.01 * jitter[2]}
        if "joints" in due:
            a, b, c, d = (angle + self.noise * jitter[3] for angle in self.angles)
            measured["joints"] = joint_angles((a, b), (c, d))
        if "odometry" in due:
            speed = SPEED * self.runs * (1 + 0.01 * jitter[7])
            measured["odometry"] = {"speed": speed}
        return measured

    def run(
        self,
        seconds: float,
        change: Mutation = lambda device, message: None,
        clock: Callable[[float], float] = lambda time: time,
        drop: tuple[str, ...] = (),
    ) -> list[Moment]:
        """Let time pass; return its moments. ``clock``: the controller's, by the true time."""
        begun = len(self.trace)
        for _ in range(round(seconds / TICK)):
            self.now += TICK
            sent = {}
            for device, message in self.messages().items():
                message["time"] = self.now
                change(device, message)
                if device not in drop:
                    sent[device] = KINDS[device](**message)
            answer = self.controller.step(clock(self.now), **sent)
            # The driver obeys.
            goal = getattr(answer, self.obeys)
            if goal is not None:
                self.goal = [goal[0], goal[0], goal[1], goal[1]]
            self.runs = answer.drive and not self.parked
            self.x += SPEED * self.runs * TICK
            for i, target in enumerate(self.goal or ()):
                most = TURN * TICK * self.turns[i // 2]
                self.angles[i] += min(most, max(-most, target - self.angles[i]))
            self.trace.append(Moment(self.now, answer, self.x, tuple(self.angles), self.runs))
        return self.trace[begun:]

    def run_until_latched(self, longest: float, change: Mutation) -> list[Moment]:
        """Let time pass until it stopped for good, and 0.2 s more; return the moments."""
        moments: list[Moment] = []
        while len(moments) * TICK < longest and not (moments and moments[-1].answer.latched):
            moments += self.run(0.2, change)
        return [*moments, *self.run(0.2, change)]


def faults(moments: list[Moment]) -> set[str]:
    return {m.answer.fault for m in moments if m.answer.fault}


def first(moments: list[Moment], state: str) -> float:
    """Return the time from the beginning until a state, infinity if it never comes [s]."""
    begun = moments[0].time - TICK
    return next((m.time - begun for m in moments if m.answer.state == state), math.inf)


def changes(moments: list[Moment]) -> int:
    """Return how often the state changed."""
    states = [m.answer.state for m in moments]
    return sum(a != b for a, b in pairwise(states))


def turned(moments: list[Moment]) -> float:
    """Return by how much a flipper turned at most [rad]."""
    angles = np.array([m.angles for m in moments])
    return float(np.abs(angles - angles[:1]).max(initial=0.0))
