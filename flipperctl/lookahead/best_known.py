"""The policy of ``planner``: it looks for the best drive of a scene, then plays it.

In: the simulator of an episode. Out: the actions of the cheapest drive that is known. Every drive
is played from the start in the simulator, so that the episode repeats it exactly.
"""

from __future__ import annotations

import math

from flipperctl.api import Perception, Policy, Simulator
from flipperctl.config import Episode, resolver
from flipperctl.lookahead.beam import Beam, Goal
from flipperctl.lookahead.model import Model
from flipperctl.lookahead.planner_settings import PlannerSettings
from flipperctl.lookahead.policy import nominal
from flipperctl.lookahead.pursuit import Drive, Pursuit, play
from flipperctl.lookahead.search import HOLD

_STARTS = ("level", "okada", "mpc")
"""Controllers whose drives the search starts from."""
_CLEARANCE = Episode().clearance
"""Height of the chassis' higher end above the ground up to which a plan has arrived [m].

A ``Simulator`` does not tell its episode's own ``clearance``, so plans aim at the default; whether
a drive has reached the finish is decided by the episode."""
_TOLERANCE = 0.3
"""Increase of a plan's predicted cost from which it is searched anew [s]."""
_SHORT_WAY, _SHORT_PATIENCE, _PITCH = 1.5, 2, 3.0
"""Length [m] of the short search, decisions between its searches, and its price of the pitch at
the end [s/rad]."""
_IMPROVEMENTS = ((4, math.inf, 0.0), (_SHORT_PATIENCE, 2 * _SHORT_WAY, _PITCH))
"""Decisions between searches, their way [m] and their price of the pitch at its end [s/rad]."""
_CUTS = (0.0, 0.2, 0.4, 0.6, 0.8)
"""Fractions of the best drive that an improvement keeps."""
_LEAST = 0.05
"""Smallest improvement that is worth another round [s]."""
_ROLLOUTS = 0.15
"""Share of the time that the first drives take."""


class PlannerPolicy:
    """Search for a plan at the start of an episode, then play it."""

    def __init__(self, settings: PlannerSettings, trained: Policy | None) -> None:
        """``trained``: a policy whose drive the search starts from."""
        self._settings = settings
        self._starts = {
            name: resolver.create("controller", name, "planner").build() for name in _STARTS
        }
        if trained is not None:
            self._starts["policy"] = trained
        self._actions: list[int] = []

    def reset(self, simulator: Simulator) -> None:
        """Search for the best drive and report how it was found."""
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
    """The search in one scene: what is known, and what it has cost."""

    def __init__(self, simulator: Simulator, settings: PlannerSettings) -> None:
        self._simulator, self._settings = simulator, settings
        self._robot = nominal(simulator.robot)
        profile = simulator.profile
        self._model = Model(profile.points, self._robot, iterations=8)
        top = profile.height(simulator.finish) + self._robot.track_radius + _CLEARANCE
        self._goal = Goal(simulator.finish, top, settings.smoothness)
        self._spent = 0
        self.best: Drive
        """The cheapest drive that reached the finish, or else the one that came farthest."""
        self._source, self._cost, self._farthest = "", math.inf, -math.inf
        self._roughest = math.inf
        """Pitch variation of the smoothest drive that the search began with [rad]."""
        self._gain = self._progress = 0.0

    def start(self, policies: dict[str, Policy]) -> None:
        """Play the drives of policies; if smoothness counts, begin with the smoothest of them."""
        simulator, share = self._simulator, _ROLLOUTS / len(policies)
        for index, (name, policy) in enumerate(policies.items()):

            def report(done: float, first: float = index * share) -> None:
                self._report(first + share * done)

            drive = play(simulator, policy, self._settings.smoothness, report)
            smoother = drive.reached and drive.variation < self._roughest
            if smoother and self._settings.smoothness > 0:
                self._cost, self._roughest = math.inf, drive.variation
            self._add(name, drive)

    def run(self) -> None:
        """Search with both widths and over a short way, then improve the best drive."""
        width = self._settings.width
        self._pursue("beam", width)
        before = self._cost
        self._pursue("doubled", 2 * width)
        self._gain = before - self._cost if math.isfinite(before) else 0.0
        self._pursue("short", width, patience=_SHORT_PATIENCE, way=_SHORT_WAY, pitch=_PITCH)
        while self._left > 0:
            before = self._cost
            for patience, way, pitch in _IMPROVEMENTS:
                for cut in _CUTS:
                    kept = self.best.actions[: int(cut * len(self.best.actions))]
                    self._pursue("improved", width, patience, kept, way, pitch)
            if self._cost > before - _LEAST:
                break
            if math.isinf(self._cost):
                width *= 2

    def result(self) -> dict[str, float | str]:
        """Return how the best drive was found."""
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
        patience: int = 1000,
        prefix: list[int] | None = None,
        way: float = math.inf,
        pitch: float = 0.0,
    ) -> None:
        """Add a drive by searches of one kind, unless it turns out dearer than the best."""
        if self._left <= 0:
            return
        settings = self._settings
        goal = Goal(self._goal.finish, self._goal.top, settings.smoothness, way, pitch)
        beam = Beam(self._model, self._robot, goal, width, settings.stretch, settings.cell)
        spent = self._spent

        def report() -> None:
            done = min(1.0, (spent + beam.spent) / settings.budget)
            self._report(_ROLLOUTS + (1 - _ROLLOUTS) * done)

        pursuit = Pursuit(beam, patience, _TOLERANCE, report)
        drive = pursuit.drive(self._simulator, prefix or (), self._cost, self._left)
        self._spent += beam.spent
        self._add(source, drive)

    def _report(self, fraction: float) -> None:
        self._progress = max(self._progress, fraction)  # a robot may roll back
        self._simulator.report_progress(self._progress)

    def _add(self, source: str, drive: Drive) -> None:
        """Remember a drive that has just been played, if it is the best."""
        if drive.reached:
            better = drive.cost < self._cost and drive.variation <= self._roughest
            if better:
                self._cost = drive.cost
        else:
            better = math.isinf(self._cost) and drive.gone > self._farthest
            if better:
                self._farthest = drive.gone
        if better:
            self.best, self._source = drive, source
