"""The policy of ``planner``: it searches for the best trajectory across a scene, then plays it.

In: the simulator of an episode. Out: the actions of the cheapest known trajectory. Every trajectory
is played from the start in the simulator, so that the episode repeats it exactly; predictions only
choose the actions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flipperctl.api import ACTIONS, FloatArray, Outcome, Perception, Policy, Simulator
from flipperctl.config import resolver
from flipperctl.core.targets import TargetRule
from flipperctl.lookahead.beam import Beam, Goal
from flipperctl.lookahead.dynamics import MOST_EXACT
from flipperctl.lookahead.model import TARGETS, Model
from flipperctl.lookahead.mpc_policy import nominal
from flipperctl.lookahead.search import HOLD, highest_at_finish
from flipperctl.lookahead.settings import PlannerSettings

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


_BIN_LENGTH = 0.12
"""Length of a distance bin, in which nodes compete [m]."""
_STARTS = ("level", "okada", "mpc")
"""Controllers whose trajectories the search starts from."""
_TOLERANCE = 0.3
"""Increase of a plan's predicted cost that triggers a new search [s]."""
_SHORT_DISTANCE, _SHORT_PATIENCE, _PITCH = 1.5, 2, 3.0
"""Distance of the short search [m], decisions between its searches, and its cost weight of the
final pitch [s/rad]."""
_IMPROVEMENTS = ((4, math.inf, 0.0), (_SHORT_PATIENCE, 2 * _SHORT_DISTANCE, _PITCH))
"""Decisions between searches, their distance [m] and cost weight of the final pitch [s/rad]."""
_CUTS = (0.0, 0.2, 0.4, 0.6, 0.8)
"""Fractions of the best trajectory that an improvement keeps."""
_LEAST = 0.05
"""Smallest improvement that starts another round [s]."""
_INITIAL_SHARE = 0.15
"""Share of the progress for the trajectories of other policies."""


class PlannerPolicy:
    """Search for a plan at the start of an episode, then play it."""

    def __init__(self, settings: PlannerSettings, trained: Policy | None) -> None:
        """``trained``: a policy whose trajectory the search starts from."""
        self._settings = settings
        self._starts = {
            name: resolver.create(
                "controller", resolver.reference(name, "planner"), "planner"
            ).build()
            for name in _STARTS
        }
        if trained is not None:
            self._starts["policy"] = trained
        self._actions: list[int] = []

    def reset(self, simulator: Simulator) -> None:
        """Search for the best trajectory and report how it was found."""
        search = _Search(simulator, self._settings)
        search.start(self._starts)
        search.run()
        self._actions = search.best.actions[::-1]
        simulator.report_progress(1.0)
        simulator.report_result(**search.result())

    def act(self, p: Perception) -> int:
        """Return the next action of the plan, and hold the flippers after its last one."""
        return self._actions.pop() if self._actions else HOLD


class _Search:
    """The search in one scene, with its best trajectory and the decisions spent."""

    def __init__(self, simulator: Simulator, settings: PlannerSettings) -> None:
        self._simulator, self._settings = simulator, settings
        self._robot = nominal(simulator.robot)
        profile = simulator.profile
        known = simulator.perceive_exactly().friction
        friction = 1.0 if known is None else known
        self._model = Model(
            profile.points, self._robot, friction=friction, iterations=8, contacts=MOST_EXACT
        )
        top = highest_at_finish(profile, self._robot, simulator.finish)
        self._goal = Goal(simulator.finish, top=top, smoothness=settings.smoothness)
        self._spent = 0
        self.best: Trajectory
        """The cheapest trajectory that reached the finish, or else the one that came farthest."""
        self._source, self._cost, self._farthest = "", math.inf, -math.inf
        self._roughest = math.inf
        """Pitch variation of the smoothest trajectory that the search began with [rad]."""
        self._gain = self._progress = 0.0

    def start(self, policies: dict[str, Policy]) -> None:
        """Play the policies; if smoothness counts, begin with the smoothest trajectory."""
        simulator, share = self._simulator, _INITIAL_SHARE / len(policies)
        for index, (name, policy) in enumerate(policies.items()):

            def report(done: float, first: float = index * share) -> None:
                self._report(first + share * done)

            played = play(simulator, policy, self._settings.smoothness, report)
            smoother = played.reached and played.variation < self._roughest
            if smoother and self._settings.smoothness > 0:
                self._cost, self._roughest = math.inf, played.variation
            self._add(name, played)

    def run(self) -> None:
        """Search with both widths and over a short distance, then improve the best trajectory."""
        width = self._settings.width
        self._pursue("beam", width)
        before = self._cost
        self._pursue("doubled", 2 * width)
        self._gain = before - self._cost if math.isfinite(before) else 0.0
        self._pursue(
            "short", width, patience=_SHORT_PATIENCE, distance=_SHORT_DISTANCE, pitch=_PITCH
        )
        while self._left > 0:
            before = self._cost
            for patience, distance, pitch in _IMPROVEMENTS:
                for cut in _CUTS:
                    kept = self.best.actions[: int(cut * len(self.best.actions))]
                    self._pursue(
                        "improved",
                        width,
                        patience=patience,
                        prefix=kept,
                        distance=distance,
                        pitch=pitch,
                    )
            if self._cost > before - _LEAST:
                break
            if math.isinf(self._cost):
                width *= 2

    def result(self) -> dict[str, float | str]:
        """Return how the best trajectory was found."""
        settings = self._settings
        return {
            "source": self._source,
            "width": settings.width,
            "budget": settings.budget,
            "decisions": self._spent,
            "doubled_gain": self._gain,
        }

    @property
    def _left(self) -> int:
        return self._settings.budget - self._spent

    def _pursue(
        self,
        source: str,
        width: int,
        *,
        patience: int = 1000,
        prefix: Sequence[int] = (),
        distance: float = math.inf,
        pitch: float = 0.0,
    ) -> None:
        """Add a trajectory by searches of one kind, unless it costs more than the best."""
        if self._left <= 0:
            return
        settings = self._settings
        goal = replace(self._goal, distance=distance, pitch=pitch)
        beam = Beam(
            self._model,
            self._robot,
            goal,
            width=width,
            bin_length=_BIN_LENGTH,
            cell=settings.cell,
        )
        spent = self._spent

        def report() -> None:
            done = min(1.0, (spent + beam.spent) / settings.budget)
            self._report(_INITIAL_SHARE + (1 - _INITIAL_SHARE) * done)

        pursuit = Pursuit(beam, patience, _TOLERANCE, report)
        found = pursuit.play(self._simulator, prefix, bound=self._cost, budget=self._left)
        self._spent += beam.spent
        self._add(source, found)

    def _report(self, fraction: float) -> None:
        self._progress = max(self._progress, fraction)  # a robot may roll back
        self._simulator.report_progress(self._progress)

    def _add(self, source: str, played: Trajectory) -> None:
        """Keep a trajectory that has just been played, if it is the best."""
        if played.reached:
            better = played.cost < self._cost and played.variation <= self._roughest
            if better:
                self._cost = played.cost
        else:
            better = math.isinf(self._cost) and played.x > self._farthest
            if better:
                self._farthest = played.x
        if better:
            self.best, self._source = played, source
