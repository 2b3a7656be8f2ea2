"""Drives played in the simulator, from the start to their end: of policies, plans and searches.

In: a simulator. Out: the actions of a drive, how it ended and what it cost. The simulator decides;
predictions only choose the actions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from flipperctl.api import ACTIONS, FloatArray, Outcome, Policy, Robot, Simulator
from flipperctl.lookahead.beam import Beam, Way
from flipperctl.lookahead.model import TARGETS
from flipperctl.lookahead.search import HOLD
from flipperctl.runtime.targets import TargetRule


@dataclass
class Drive:
    """A drive from the start; ``step`` plays its next decision in the simulator."""

    simulator: Simulator
    smoothness: float
    """Price of the pitch variation at 100 Hz [s/rad]."""
    actions: list[int] = field(default_factory=list)
    variation: float = 0.0
    """Pitch variation at 100 Hz so far [rad]."""
    outcome: Outcome | None = None

    def __post_init__(self) -> None:
        """Return to the start."""
        self.simulator.restart()
        state, robot = self.simulator.state, self.simulator.robot
        self._rule = TargetRule(window=robot.angle_step, limit=robot.angle_limit)
        self.targets = state.front, state.rear
        """Commanded angles of the front and the rear flippers in frame R [rad]."""

    def step(self, action: int) -> None:
        """Play one decision."""
        state, step = self.simulator.state, self.simulator.robot.angle_step
        front, rear = ACTIONS[action]
        self.targets = self._rule.next_targets(
            self.targets, (state.front, state.rear), (front * step, rear * step)
        )
        self.outcome = self.simulator.step(action)
        self.actions.append(action)
        self.variation += float(np.abs(np.diff(self.simulator.poses[:, 2])).sum())

    @property
    def reached(self) -> bool:
        """True if the robot is at the finish."""
        return self.outcome is Outcome.REACHED

    @property
    def gone(self) -> float:
        """World x of the chassis centre [m]."""
        return float(self.simulator.state.position[0])

    @property
    def cost(self) -> float:
        """Cost so far: time and variation [s]."""
        return self.simulator.state.time + self.smoothness * self.variation


def root(drive: Drive, beam: Beam) -> FloatArray:
    """Return the present state of the drive as one of the prediction model, (``STATE``,)."""
    state = drive.simulator.state
    x, z = state.position.tolist()
    rates = (*state.velocity.tolist(), state.pitch_rate)
    found = beam.model.state((x, z, state.pitch), (state.front, state.rear), rates)
    found[TARGETS:] = drive.targets
    return found


def play(simulator: Simulator, policy: Policy, smoothness: float) -> Drive:
    """Return the drive of a policy, which perceives what it does in the episode."""
    drive = Drive(simulator, smoothness)
    policy.reset(simulator)
    while drive.outcome is None:
        drive.step(policy.act(simulator.perceive()))
    return drive
