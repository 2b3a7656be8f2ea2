"""The policy of ``planner``: it searches for the best trajectory across a scene, then plays it.

In: the simulator of an episode. Out: the actions of the cheapest known trajectory. Every trajectory
is played from the start in the simulator, so that the episode repeats it exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from flipperctl.api import Perception, Policy, Simulator
from flipperctl.config import resolver
from flipperctl.lookahead.beam import Beam, Goal
from flipperctl.lookahead.contacts import MOST_EXACT
from flipperctl.lookahead.goal import highest_at_finish
from flipperctl.lookahead.model import Model
from flipperctl.lookahead.planner_settings import PlannerSettings
from flipperctl.lookahead.policy import nominal
from flipperctl.lookahead.pursuit import Pursuit, Trajectory, play
from flipperctl.lookahead.search import HOLD

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
            bin_length=settings.stretch,
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
