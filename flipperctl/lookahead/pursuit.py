"""Trajectories played in the simulator from the start: those of policies, plans and searches.

In: a simulator. Out: the actions of a trajectory, its outcome and its cost. Both are the
simulator's; predictions only choose the actions.
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
"""Pitch at the end of a short search that the cost bound allows for [rad]."""


@dataclass
class Trajectory:
    """A trajectory from the start; ``step`` plays its next decision in the simulator."""

    simulator: Simulator
    smoothness: float
    """Cost weight of the pitch variation at 100 Hz [s/rad]."""
    actions: list[int] = field(default_factory=list)
    variation: float = 0.0
    """Pitch variation at 100 Hz so far [rad]."""
    outcome: Outcome | None = None

    def __post_init__(self) -> None:
        """Restart the simulator."""
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
        """Whether the robot has reached the finish."""
        return self.outcome is Outcome.REACHED

    @property
    def x(self) -> float:
        """World x of the chassis centre [m]."""
        return float(self.simulator.state.position[0])

    @property
    def cost(self) -> float:
        """Cost so far: time and weighted pitch variation [s]."""
        return self.simulator.state.time + self.smoothness * self.variation


def root(played: Trajectory, beam: Beam) -> FloatArray:
    """Return the present state as a state of the prediction model, (``STATE``,)."""
    state = played.simulator.state
    x, z = state.position.tolist()
    rates = (*state.velocity.tolist(), state.pitch_rate)
    found = beam.model.state((x, z, state.pitch), (state.front, state.rear), rates)
    found[TARGETS:] = played.targets
    return found


def play(
    simulator: Simulator,
    policy: Policy,
    smoothness: float,
    report: Callable[[float], None] = lambda fraction: None,
) -> Trajectory:
    """Return the trajectory of a policy, with the perceptions that it has in the episode.

    ``report`` is called with the fraction of the distance that is done.
    """
    played = Trajectory(simulator, smoothness)
    begin = played.x
    policy.reset(simulator)
    while played.outcome is None:
        played.step(policy.act(simulator.perceive()))
        report(min(1.0, max(0.0, (played.x - begin) / (simulator.finish - begin))))
    return played


@dataclass(frozen=True)
class Pursuit:
    """Follows plans, and searches again where the simulator departs from the prediction."""

    beam: Beam
    patience: int
    """Decisions after which a new search is made in any case [-]."""
    tolerance: float
    """Increase of a plan's predicted cost that triggers a new search [s]."""
    report: Callable[[], None] = lambda: None
    """Called after each search."""

    def play(
        self,
        simulator: Simulator,
        prefix: Sequence[int] = (),
        *,
        bound: float = math.inf,
        budget: float = math.inf,
    ) -> Trajectory:
        """Return a trajectory that begins with the actions ``prefix``.

        It stops without an outcome when no plan is predicted to cost less than ``bound`` [s], or
        after ``budget`` predicted decisions.
        """
        beam = self.beam
        played, limit = Trajectory(simulator, beam.goal.smoothness), beam.spent + budget
        for action in prefix:
            if played.outcome is None:
                played.step(action)
        plan: tuple[int, ...] = ()
        expected, age = 0.0, 0
        while played.outcome is None:
            left = max(0.0, simulator.finish - played.x) / simulator.speed
            if played.cost + left >= bound or beam.spent >= limit:
                break
            here = root(played, beam)
            best = beam.follow(here, plan)
            if not best.complete or age >= self.patience or best.cost > expected + self.tolerance:
                slack = self.tolerance + beam.goal.pitch * _LEANING
                found = beam.search(
                    here, budget=limit - beam.spent, bound=bound - played.cost + slack
                )
                self.report()
                age = 0
                if not (best.complete and best.cost <= found.cost):
                    best = found
                if not best.complete and math.isfinite(bound):
                    break  # no plan from here costs less than the bound
            plan = best.actions or (HOLD,)
            before = played.cost - played.x / simulator.speed
            played.step(plan[0])
            paid = played.cost - played.x / simulator.speed - before
            plan, expected, age = plan[1:], best.cost - paid, age + 1
        return played
