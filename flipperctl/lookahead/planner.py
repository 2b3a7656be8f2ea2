"""The policy of ``planner``: it searches for the best trajectory across a scene, then plays it.

In: the simulator of an episode. Out: the actions of the cheapest known trajectory. Every trajectory
is played from the start in the simulator, so that the episode repeats it exactly; predictions only
choose the actions. They come from beam searches on the true ground, to the finish or over a
requested distance. Nodes compete within a distance bin and not within a depth. Otherwise nodes that
wait in front of an obstacle would displace nodes that climb it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Outcome, Perception, Policy, Robot, Simulator
from flipperctl.config import resolver
from flipperctl.lookahead.dynamics import MOST_EXACT
from flipperctl.lookahead.model import FLIPPERS, Model, next_targets, nominal
from flipperctl.lookahead.search import HOLD, Planned, highest_at_finish, moves, target_cell
from flipperctl.lookahead.settings import STEEP, STEEP_FROM, PlannerSettings

_ROUNDS = 8  # largest number of decisions of a node in one distance bin


@dataclass(frozen=True)
class Goal:
    """Where a search ends, and the cost weights of its plans."""

    finish: float  # world x that the chassis centre must pass [m]
    top: float  # largest world z of the chassis' ends at the finish [m]
    smoothness: float  # cost weight of the pitch variation at 100 Hz [s/rad]
    distance: float = math.inf  # distance after which a search ends short of the finish [m]
    pitch: float = 0.0  # cost weight of the absolute pitch after that distance [s/rad]


class SearchResult(NamedTuple):
    """The result of a search, or of a simulated plan."""

    actions: tuple[int, ...]
    cost: float
    """Cost from the root: time, remaining time at full speed, weighted pitch variation [s]."""
    complete: bool  # Whether the plan reaches the finish or the requested distance


@dataclass
class _Nodes:
    """Search nodes as rows of arrays."""

    states: FloatArray
    places: FloatArray
    time: FloatArray
    variation: FloatArray
    steep: FloatArray
    cost: FloatArray
    parent: NDArray[np.int64]
    action: NDArray[np.int64]

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> _Nodes:
        return _Nodes(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    @classmethod
    def joined(cls, parts: list[_Nodes]) -> _Nodes:
        if len(parts) == 1:
            return parts[0]
        names = cls.__dataclass_fields__
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass
class Beam:
    """A beam search on one ground with one robot; ``spent`` counts its simulated decisions."""

    model: Model
    robot: Robot
    goal: Goal
    width: int  # nodes that are expanded in each distance bin
    bin_length: float  # length of a distance bin [m]
    cell: float
    """Nodes closer than this in position and pitch, with equal targets, are merged [m, rad]."""
    spent: int = field(default=0, init=False)

    def search(
        self, root: FloatArray, budget: float = math.inf, bound: float = math.inf
    ) -> SearchResult:
        """Return the cheapest plan from the state ``root``, (``STATE``,).

        If no plan below the cost ``bound`` [s] reaches the requested distance within ``budget``
        decisions, return the plan that came farthest.
        """
        start, begin, last = self._begin(root)
        bins: dict[int, list[_Nodes]] = {0: [start]}
        expanded: list[_Nodes] = []
        count, best, final, farthest = 0, bound, (-1, -1), (begin, -1, -1)
        limit = self.spent + budget
        # The rearmost bin comes first, so that nodes compete with others that came as far.
        while bins and self.spent < limit:
            index = min(bins)
            fresh = bins.pop(index)
            seen = np.zeros(0)
            # Children that stay in the bin are expanded in further rounds.
            for _ in range(_ROUNDS):
                nodes = self._beam(_Nodes.joined(fresh), seen, best)
                if not len(nodes.cost) or self.spent >= limit:
                    break
                seen = np.concatenate([seen, nodes.cost])
                expanded.append(nodes)
                children = self._children(nodes, count)
                count += len(nodes.cost)
                # The cheapest plan that ends bounds the cost of all others.
                ended = self._ended(children, last)
                if ended.any():
                    row = np.flatnonzero(ended)[np.argmin(children.cost[ended])]
                    if children.cost[row] < best:
                        best = float(children.cost[row])
                        final = int(children.parent[row]), int(children.action[row])
                children = children.take(~ended)
                if not len(children.cost):
                    break
                # The farthest node is the answer if no plan ends.
                row = int(np.argmax(children.places[:, 0]))
                if (x := float(children.places[row, 0])) > farthest[0]:
                    farthest = x, int(children.parent[row]), int(children.action[row])
                # Children compete in the bin that they have reached, and in no earlier one.
                at = ((children.places[:, 0] - begin) / self.bin_length).astype(np.int64)
                at = np.maximum(at, index)
                for depth in np.unique(at[at > index]).tolist():
                    bins.setdefault(depth, []).append(children.take(at == depth))
                fresh = [children.take(at == index)]
                if not len(fresh[0].cost):
                    break
        complete = final[0] >= 0
        actions = _trace(expanded, *(final if complete else farthest[1:]))
        return SearchResult(actions, best if complete else math.inf, complete)

    def follow(self, root: FloatArray, actions: tuple[int, ...]) -> SearchResult:
        """Simulate a plan from the state ``root``, with the same costs as in ``search``."""
        nodes, _, last = self._begin(root)
        for done, action in enumerate(actions):
            children = self._children(nodes, 0, action)
            if not len(children.cost):
                return SearchResult(actions[:done], math.inf, False)
            nodes = children
            if self._ended(nodes, last)[0]:
                return SearchResult(actions[: done + 1], float(nodes.cost[0]), True)
        return SearchResult(actions, math.inf, False)

    def _begin(self, root: FloatArray) -> tuple[_Nodes, float, float]:
        """Return the node of a state, its x, and the x at which a search from it ends [m]."""
        place, zero, none = np.array([self.model.chassis(root)]), np.zeros(1), np.array([-1])
        begin = float(place[0, 0])
        last = min(self.goal.finish, begin + self.goal.distance)
        return _Nodes(root[None], place, zero, zero, zero, zero, none, none), begin, last

    def _beam(self, nodes: _Nodes, seen: FloatArray, best: float) -> _Nodes:
        """Return the nodes to expand, cheapest first.

        ``seen``: costs of the nodes that were expanded in this bin before [s].
        """
        # Among the nodes in one cell, only the cheapest is expanded.
        nodes = nodes.take(nodes.cost < best)
        nodes = nodes.take(np.argsort(nodes.cost, kind="stable"))
        keys = np.column_stack(
            [
                nodes.places / self.cell,
                nodes.states[:, 2] / self.cell,
                nodes.states[:, FLIPPERS:] / target_cell(self.robot),
            ]
        )
        _, first = np.unique(np.round(keys).astype(np.int64), axis=0, return_index=True)
        nodes = nodes.take(np.sort(first))
        # The width counts the cheaper nodes of earlier rounds, too.
        rank = np.searchsorted(np.sort(seen), nodes.cost) + np.arange(len(nodes.cost))
        return nodes.take(rank < self.width)

    def _children(self, nodes: _Nodes, first: int, action: int | None = None) -> _Nodes:
        """Return the nodes one decision later that have not overturned."""
        parent, taken, targets = moves(nodes.states, self.robot)
        if action is not None:
            rows = taken == action
            if not rows.any():  # turning a flipper against its stop
                rows = taken == HOLD
            parent, taken, targets = parent[rows], taken[rows], targets[rows]
        period, speed = self.robot.decision_period, self.robot.track_speed
        branch = self.model.expand(nodes.states[parent], targets, period)
        self.spent += len(parent)
        time = nodes.time[parent] + period
        variation = nodes.variation[parent] + branch.pitch_variation
        steep = np.maximum(nodes.steep[parent], branch.steepest)
        # Time so far, time left at full speed, pitch variation and steepness
        left = (self.goal.finish - branch.places[:, 0]) / speed  # negative past the finish
        cost = time + left + self.goal.smoothness * variation
        cost += STEEP * np.maximum(0.0, steep - STEEP_FROM)
        children = _Nodes(
            branch.states, branch.places, time, variation, steep, cost, first + parent, taken
        )
        return children.take(branch.steepest < self.model.overturn)

    def _ended(self, nodes: _Nodes, last: float) -> NDArray[np.bool_]:
        """Return which nodes end the search; short of the finish, add the cost of their pitch."""
        x, z = nodes.places.T
        ended = x >= last
        if last >= self.goal.finish:
            high = z + self.robot.hinge_offset * np.abs(np.sin(nodes.states[:, 2]))
            ended &= high <= self.goal.top
        else:
            nodes.cost[ended] += self.goal.pitch * np.abs(nodes.states[ended, 2])
        return np.asarray(ended)


def _trace(expanded: list[_Nodes], node: int, action: int) -> tuple[int, ...]:
    """Return the actions from the root to the child of ``node`` by ``action``."""
    actions: list[int] = []
    ends = np.cumsum([len(part.cost) for part in expanded])
    while node >= 0:
        actions.append(action)
        part = int(np.searchsorted(ends, node, side="right"))
        row = node - (int(ends[part - 1]) if part else 0)
        node, action = int(expanded[part].parent[row]), int(expanded[part].action[row])
    return tuple(actions[::-1])


_LEANING = 0.5  # pitch at the end of a short search that the cost bound allows for [rad]


@dataclass
class Trajectory:
    """A trajectory from the start; ``step`` plays its next decision in the simulator."""

    simulator: Simulator
    smoothness: float  # cost weight of the pitch variation at 100 Hz [s/rad]
    actions: list[int] = field(default_factory=list)
    variation: float = 0.0  # pitch variation at 100 Hz so far [rad]
    outcome: Outcome | None = None

    def __post_init__(self) -> None:
        """Restart the simulator."""
        self.simulator.restart()
        state = self.simulator.state
        self.targets = state.front, state.rear
        """Commanded angles of the front and the rear flippers in frame R [rad]."""

    def step(self, action: int) -> None:
        """Play one decision."""
        state, robot = self.simulator.state, self.simulator.robot
        self.targets = next_targets(robot, self.targets, (state.front, state.rear), action)
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
        action = policy.act(simulator.perceive())
        assert isinstance(action, int)  # of the controllers that it starts from
        played.step(action)
        report(min(1.0, max(0.0, (played.x - begin) / (simulator.finish - begin))))
    return played


_BIN_LENGTH = 0.12  # length of a distance bin, in which nodes compete [m]
_STARTS = ("level", "okada", "mpc")  # controllers whose trajectories the search starts from
_TOLERANCE = 0.3  # increase of a plan's predicted cost that triggers a new search [s]
_SHORT_DISTANCE, _SHORT_PATIENCE, _PITCH = 1.5, 2, 3.0
"""Distance of the short search [m], decisions between its searches, and its cost weight of the
final pitch [s/rad]."""
_IMPROVEMENTS = ((4, math.inf, 0.0), (_SHORT_PATIENCE, 2 * _SHORT_DISTANCE, _PITCH))
"""Decisions between searches, their distance [m] and cost weight of the final pitch [s/rad]."""
_CUTS = (0.0, 0.2, 0.4, 0.6, 0.8)  # fractions of the best trajectory that an improvement keeps
_LEAST = 0.05  # smallest improvement that starts another round [s]
_INITIAL_SHARE = 0.15  # share of the progress for the trajectories of other policies


class PlannerPolicy:
    """Search for a plan at the start of an episode, then play it."""

    def __init__(self, settings: PlannerSettings, trained: Policy | None) -> None:
        """``trained``: a policy whose trajectory the search starts from."""
        self._settings = settings
        references = {name: resolver.reference(name, "planner") for name in _STARTS}
        self._starts = {
            name: resolver.create("controller", reference, "planner").build()
            for name, reference in references.items()
        }
        if trained is not None:
            self._starts["policy"] = trained
        self._actions: tuple[int, ...] = ()
        self._next = 0
        self._places = np.empty((0, 2))
        self._simulator: Simulator | None = None

    def reset(self, simulator: Simulator) -> None:
        """Search for the best trajectory and report how it was found."""
        search = _Search(simulator, self._settings)
        search.start(self._starts)
        search.run()
        self._actions, self._next = tuple(search.best.actions), 0
        self._places, self._simulator = np.empty((0, 2)), simulator
        simulator.report_progress(1.0)
        simulator.report_result(**search.result())

    def act(self, p: Perception) -> int:
        """Return the next action of the plan, and hold the flippers after its last one."""
        self._next += 1
        return self._actions[self._next - 1] if self._next <= len(self._actions) else HOLD

    @property
    def planned(self) -> Planned | None:
        """What was left of the plan at the last decision; it is simulated once it is asked for."""
        if self._simulator is None or not self._next:
            return None
        if not len(self._places):
            self._simulator.restart()
            places = [self._simulator.state.position]
            for action in self._actions:
                self._simulator.step(action)
                places.append(self._simulator.state.position)
            self._places = np.array(places)
        now = min(self._next - 1, len(self._actions))
        return Planned(self._actions[now:], self._places[now:] - self._places[now])


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
            # A smoother trajectory begins the search anew, since none may be rougher than it.
            smoother = played.reached and played.variation < self._roughest
            if smoother and self._settings.smoothness > 0:
                self._cost, self._roughest = math.inf, played.variation
            self._add(name, played)

    def run(self) -> None:
        """Search with both widths and over a short distance, then improve the best trajectory."""
        width = self._settings.width
        # From the start, with two widths, then with plans over a short distance
        self._pursue("beam", width)
        before = self._cost
        self._pursue("doubled", 2 * width)
        self._gain = before - self._cost if math.isfinite(before) else 0.0
        self._pursue("short", width, _SHORT_PATIENCE, _SHORT_DISTANCE, _PITCH)
        # Keep a part of the best trajectory, and search for a better end.
        while self._left > 0:
            before = self._cost
            for kind in _IMPROVEMENTS:
                for cut in _CUTS:
                    prefix = self.best.actions[: int(cut * len(self.best.actions))]
                    self._pursue("improved", width, *kind, prefix=prefix)
            # Rounds end once they gain little; the width grows while no trajectory reaches the
            # finish.
            if self._cost > before - _LEAST:
                break
            if math.isinf(self._cost):
                width *= 2

    def result(self) -> dict[str, float | str]:
        """Return how the best trajectory was found."""
        width, budget = self._settings.width, self._settings.budget
        sizes = {"width": width, "budget": budget, "decisions": self._spent}
        return {"source": self._source, **sizes, "doubled_gain": self._gain}

    @property
    def _left(self) -> int:
        return self._settings.budget - self._spent

    def _pursue(
        self,
        source: str,
        width: int,
        patience: int = 1000,
        distance: float = math.inf,
        pitch: float = 0.0,
        prefix: Sequence[int] = (),
    ) -> None:
        """Add a trajectory by searches of one kind, unless it costs more than the best."""
        if self._left <= 0:
            return
        goal = replace(self._goal, distance=distance, pitch=pitch)
        cell = self._settings.cell
        beam = Beam(self._model, self._robot, goal, width, bin_length=_BIN_LENGTH, cell=cell)
        plan = self._played(beam, prefix, patience)
        self._spent += beam.spent
        self._add(source, plan)

    def _played(self, beam: Beam, prefix: Sequence[int], patience: int) -> Trajectory:
        """Return a trajectory that begins with the actions ``prefix`` and follows plans.

        A new search is made where the simulator departs from the prediction, or after ``patience``
        decisions. The trajectory stops without an outcome when no plan is predicted to cost less
        than the best one, or once the budget is spent.
        """
        simulator, bound, budget = self._simulator, self._cost, self._left
        played = Trajectory(simulator, beam.goal.smoothness)
        for action in prefix:
            if played.outcome is None:
                played.step(action)
        plan: tuple[int, ...] = ()
        expected, age = 0.0, 0
        while played.outcome is None:
            # No way to the finish is cheaper than the best trajectory.
            left = max(0.0, simulator.finish - played.x) / simulator.speed
            if played.cost + left >= bound or beam.spent >= budget:
                break
            # The plan is kept while the simulator follows its prediction.
            here = beam.model.known(simulator.state, played.targets)
            best = beam.follow(here, plan)
            if not best.complete or age >= patience or best.cost > expected + _TOLERANCE:
                # Else a search from here replaces it, unless the rest of the old plan is cheaper.
                slack = _TOLERANCE + beam.goal.pitch * _LEANING
                candidate = beam.search(
                    here, budget=budget - beam.spent, bound=bound - played.cost + slack
                )
                done = min(1.0, (self._spent + beam.spent) / self._settings.budget)
                self._report(_INITIAL_SHARE + (1 - _INITIAL_SHARE) * done)
                age = 0
                if not (best.complete and best.cost <= candidate.cost):
                    best = candidate
                if not best.complete and math.isfinite(bound):
                    break  # no plan from here costs less than the bound
            # Play a decision; the rest of the plan should cost what is left.
            plan = best.actions or (HOLD,)
            before = played.cost - played.x / simulator.speed
            played.step(plan[0])
            paid = played.cost - played.x / simulator.speed - before
            plan, expected, age = plan[1:], best.cost - paid, age + 1
        return played

    def _report(self, fraction: float) -> None:
        self._progress = max(self._progress, fraction)  # a robot may roll back
        self._simulator.report_progress(self._progress)

    def _add(self, source: str, played: Trajectory) -> None:
        """Keep a trajectory that has just been played, if it is the best."""
        if played.reached:
            if not (played.cost < self._cost and played.variation <= self._roughest):
                return
            self._cost = played.cost
        elif math.isinf(self._cost) and played.x > self._farthest:
            self._farthest = played.x
        else:
            return
        self.best, self._source = played, source
