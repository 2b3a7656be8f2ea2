"""Drives played in the simulator, from the start to their end: of policies, plans and searches.

In: a simulator. Out: the actions of a drive, how it ended and what it cost. The simulator decides;
predictions only choose the actions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from flipperctl.api import ACTIONS, FloatArray, Outcome, Policy, Simulator
from flipperctl.core.targets import TargetRule
from flipperctl.lookahead.beam import Beam
from flipperctl.lookahead.model import TARGETS
from flipperctl.lookahead.search import HOLD

_LEANING = 0.5
"""Pitch at the end of a short search that is taken for granted [rad]."""


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


def play(
    simulator: Simulator,
    policy: Policy,
    smoothness: float,
    report: Callable[[float], None] = lambda fraction: None,
) -> Drive:
    """Return the drive of a policy, which perceives what it does in the episode.

    ``report`` is called with the fraction of the way that is done.
    """
    drive = Drive(simulator, smoothness)
    begin = drive.gone
    policy.reset(simulator)
    while drive.outcome is None:
        drive.step(policy.act(simulator.perceive()))
        report(min(1.0, max(0.0, (drive.gone - begin) / (simulator.finish - begin))))
    return drive


@dataclass(frozen=True)
class Pursuit:
    """A drive by plans that are searched anew where the simulator departs from the prediction."""

    beam: Beam
    patience: int
    """Decisions after which a plan is searched anew in any case [-]."""
    tolerance: float
    """Increase of a plan's predicted cost from which it is searched anew [s]."""
    report: Callable[[], None] = lambda: None
    """Called after each search."""

    def drive(
        self,
        simulator: Simulator,
        prefix: Sequence[int] = (),
        bound: float = math.inf,
        budget: float = math.inf,
    ) -> Drive:
        """Return a drive that begins with the actions ``prefix``.

        It breaks off, without an outcome, where no plan is predicted to cost less than ``bound``
        [s], or after ``budget`` predicted decisions.
        """
        beam = self.beam
        drive, limit = Drive(simulator, beam.goal.smoothness), beam.spent + budget
        for action in prefix:
            if drive.outcome is None:
                drive.step(action)
        plan: tuple[int, ...] = ()
        expected, age = 0.0, 0
        while drive.outcome is None:
            left = max(0.0, simulator.finish - drive.gone) / simulator.speed
            if drive.cost + left >= bound or beam.spent >= limit:
                break
            here = root(drive, beam)
            way = beam.follow(here, plan)
            if not way.complete or age >= self.patience or way.cost > expected + self.tolerance:
                slack = self.tolerance + beam.goal.pitch * _LEANING
                found = beam.search(here, limit - beam.spent, bound - drive.cost + slack)
                self.report()
                age = 0
                if not (way.complete and way.cost <= found.cost):
                    way = found
                if not way.complete and math.isfinite(bound):
                    break  # nothing cheaper than the bound leads on from here
            plan = way.actions or (HOLD,)
            before = drive.cost - drive.gone / simulator.speed
            drive.step(plan[0])
            paid = drive.cost - drive.gone / simulator.speed - before
            plan, expected, age = plan[1:], way.cost - paid, age + 1
        return drive
