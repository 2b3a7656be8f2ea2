"""The policy of ``value_iteration``: it knows the ground, and the value of every state on it.

In: the simulator of an episode. Out: the actions of the largest return, their values, and groups of
states that lie close to each other, from which a student learns. A student that sees a metre of the
ground cannot know what comes after; states of one group share it, so that their differences are
what the student can learn.

The prediction model explores all flipper settings along the whole ground. The first state in a cell
of position, pitch and flipper targets represents all states in that cell. A decision that ends in a
cell leads to the cell's representative. Value iteration on this graph (Bellman 1957) gives the
value of each action in each state, also in states that no good policy would visit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    ACTIONS,
    FloatArray,
    ObservationLayout,
    Outcome,
    Perception,
    Profile,
    RewardTerm,
    Robot,
    Simulator,
    StateGroups,
    action_index,
)
from flipperctl.config import Episode
from flipperctl.config.reward_sum import RewardSum
from flipperctl.lookahead.dynamics import MOST_EXACT, RUNNING
from flipperctl.lookahead.model import (
    FLIPPERS,
    TARGETS,
    Ground,
    Model,
    Nodes,
    compile_now,
    next_targets,
    nominal,
    transitions,
)
from flipperctl.lookahead.search import HOLD, History, Returns, Search, highest_at_finish, moves
from flipperctl.lookahead.settings import ValueIterationSettings

_SHARE = 0.5  # length of a cell as a share of the way of a decision at full speed [-]
_PITCH, _HEIGHT = 0.08, 0.1  # size of a cell in pitch [rad] and in height [m]
_MOST = 60_000  # number of represented states from which no further ones are explored [-]
_DROP, _SETTLE = 0.45, 1.5
"""Height of the robots above the ground at the start [m], and time to come to rest [s]; longer
flippers need more of both."""
_BEYOND = 1.5  # distance before the start and past the finish at which the exploration ends [m]
_SLOW = 0.1  # share of the way of a decision at full speed below which the robot stands [-]
_BESIDE = sorted(
    (shift for shift in product((-1, 0, 1), repeat=3) if any(shift)),
    key=lambda shift: sum(map(abs, shift)),
)
"""Shifts in x, z and pitch to the cells beside one, the nearest first."""
_ACCURACY = 1e-3  # largest change of a value in the last sweep [-]
_SWEEPS = 1000


@dataclass(frozen=True)
class Course:
    """A known ground with start and finish."""

    profile: Profile
    start: float  # world x of the chassis centre at the start [m]
    finish: float  # world x that the chassis centre must pass [m]
    patience: int  # number of decisions without progress after which the robot counts as stuck [-]


class _Edges(NamedTuple):
    """Decisions, row by row."""

    parent: NDArray[np.int64]
    action: NDArray[np.int64]
    child: NDArray[np.int64]  # represented state after the decision; -1 where the episode ends
    reward: FloatArray  # expected reward [-]
    factor: FloatArray
    """Factor of the next value: the discount times the probability that the episode goes on."""


class Graph:
    """The represented states of a course, with the value of each action."""

    def __init__(
        self, course: Course, model: Model, robot: Robot, rewards: RewardSum, gamma: float
    ) -> None:
        """Explore the course, then compute the values with the discount ``gamma`` per decision.

        ``model`` knows the ground and the finish of the course.
        """
        self._course, self._model, self._robot = course, model, robot
        self._rewards, self._gamma = rewards, gamma
        self._cells: dict[tuple[int, ...], int] = {}
        self._waves: list[Nodes] = []
        edges = list(self._explore())
        shape = len(self._cells), len(ACTIONS)
        self.child = np.full(shape, -1)
        """Represented state to which each action leads, -1 where the episode ends, (N, 9)."""
        # Tables over states and actions, filled from the decisions
        reward, factor = np.full(shape, -np.inf), np.zeros(shape)
        for e in edges:
            self.child[e.parent, e.action] = e.child
            reward[e.parent, e.action], factor[e.parent, e.action] = e.reward, e.factor
        self.nodes = Nodes.joined(self._waves)
        self.unexplored = float((~np.isfinite(reward).any(axis=1)).mean())
        """Share of the states from which nothing was explored, as the ground is too long [-]."""
        self.values = _iterated(reward, factor, self.child)
        """Value of each action, (N, 9) [-]; -inf for a turn beyond a stop."""

    @cached_property
    def best(self) -> FloatArray:
        """The value of each represented state, (N,) [-]."""
        return np.asarray(self.values.max(axis=1))

    def lookup(self, nodes: Nodes) -> NDArray[np.int64]:
        """Return the represented state of each node's cell, else of a cell beside it, (M,).

        It is -1 if neither is represented.
        """
        return np.array([self._nearest(key) for key in self._keys(nodes)], np.int64)

    def _nearest(self, key: tuple[int, ...]) -> int:
        node = self._cells.get(key, -1)
        if node >= 0:
            return node
        for shift in _BESIDE:
            x, z, pitch = (k + s for k, s in zip(key[:3], shift, strict=True))
            if (node := self._cells.get((x, z, pitch, *key[3:]), -1)) >= 0:
                return node
        return -1

    def _explore(self) -> Iterator[_Edges]:
        """Represent the reachable states wave by wave; yield the decisions of each wave."""
        frontier, base = self._represent(self._roots()), 0
        while len(frontier) and len(self._cells) < _MOST:
            layer = self._decide(frontier)
            yield layer._replace(parent=layer.parent + base)
            base += len(frontier)
            frontier = self._waves[-1]

    def _roots(self) -> Nodes:
        """Return robots at the start with each flipper setting, which have come to rest."""
        course, robot = self._course, self._robot
        most = int(robot.angle_limit / robot.angle_step + 1e-9)
        angles = np.arange(-most, most + 1) * robot.angle_step
        # Robots fall from above with every flipper setting, and drive until they have come to rest.
        lowered = robot.flipper_axle * math.sin(min(robot.angle_limit, math.pi / 2))
        drop = max(_DROP, lowered)  # so that no flipper begins below the ground
        settle = _SETTLE * math.sqrt(drop / _DROP)
        x = course.start - settle * robot.track_speed
        z = course.profile.height(course.start) + robot.track_radius + drop
        states = np.array([self._model.state((x, z, 0.0), (f, r)) for f in angles for r in angles])
        branch = self._model.expand(states, states[:, TARGETS:], settle)
        standing = branch.take(np.flatnonzero(branch.outcome == RUNNING))
        return Nodes.at_rest(standing.states, standing.places)

    def _keys(self, nodes: Nodes) -> list[tuple[int, ...]]:
        robot, states = self._robot, nodes.states
        length = _SHARE * robot.track_speed * robot.decision_period
        cells = np.column_stack(
            [
                np.floor(nodes.places[:, 0] / length),
                np.round(nodes.places[:, 1] / _HEIGHT),
                np.round(states[:, 2] / _PITCH),
                np.round(states[:, TARGETS:] / robot.angle_step),
            ]
        )
        return [tuple(row) for row in cells.astype(np.int64).tolist()]

    def _represent(self, nodes: Nodes) -> Nodes:
        """Let the first node of each new cell represent it; return these nodes."""
        fresh = []
        for row, key in enumerate(self._keys(nodes)):
            if key not in self._cells:
                self._cells[key] = len(self._cells)
                fresh.append(row)
        self._waves.append(nodes.take(np.array(fresh, np.int64)))
        return self._waves[-1]

    def _decide(self, nodes: Nodes) -> _Edges:
        """Predict every decision from each node; represent the ends in new cells.

        The path of a decision ends at the state that represents its end, so that the reward terms
        pay for the difference.
        """
        course, robot, period = self._course, self._robot, self._robot.decision_period
        parent, action, targets = moves(nodes.states, robot)
        before = nodes.take(parent)
        branch = self._model.expand(before.states, targets, period, poses=True)
        after = before.after(branch, action, period)
        # Where a decision ends within the course, a state represents its end.
        x, going = after.places[:, 0], branch.outcome == RUNNING
        inside = (x < course.finish + _BEYOND) & (x > course.start - _BEYOND)
        rows = np.flatnonzero(going & inside)
        self._represent(after.take(rows))
        child = np.full(len(parent), -1)
        child[rows] = self.lookup(after.take(rows))
        # The rewards pay for the path to the representing state.
        rows = np.flatnonzero(child >= 0)
        after = after.moved_to(Nodes.joined(self._waves).take(child[rows]), rows)
        branch = replace(branch, poses=_redirected(branch.poses, after, rows))
        ts = transitions(before, after, branch, course.profile, robot)
        reward, factor = self._rewards.array(ts), np.where(child < 0, 0.0, self._gamma)
        # An episode ends as stuck after some time without progress. The states do not hold that
        # time, so it ends with equal probability at each decision in which the robot stands.
        # Every cycle contains such a decision, so value iteration ends.
        progress = after.places[:, 0] - before.places[:, 0]
        slow = progress < _SLOW * robot.track_speed * period
        hazard = np.where(going & slow, 1.0 / course.patience, 0.0)
        hazard[going & (child < 0)] = 1.0
        rows = np.flatnonzero(hazard)
        if len(rows):
            stuck = self._rewards.array(ts.ending(rows, Outcome.STUCK))
            reward[rows] += hazard[rows] * (stuck - reward[rows])
            factor[rows] *= 1.0 - hazard[rows]
        return _Edges(parent, action, child, reward, factor)


def _redirected(poses: FloatArray, after: Nodes, rows: NDArray[np.int64]) -> FloatArray:
    """Return poses (M, S + 1, 5) that end in the states ``after``, for some ``rows``.

    The way to another position is spread over the decision, which would else end with an impact.
    The pitch jumps at the end, since a spread difference could hide pitch variation.
    """
    path, share = poses[rows], np.linspace(0.0, 1.0, poses.shape[1])[:, None]
    end = after.take(rows)
    path[:, :, :2] += share * (end.places - path[:, -1, :2])[:, None]
    path[:, -1, 2] = end.states[:, 2]
    path[:, -1, 3:] = end.states[:, FLIPPERS:TARGETS]
    poses = poses.copy()
    poses[rows] = path
    return poses


def _iterated(reward: FloatArray, factor: FloatArray, child: NDArray[np.int64]) -> FloatArray:
    """Return the values r + factor · max V(child), (N, 9), by value iteration."""
    # A state that was not explored any further goes on at the lowest reward that was seen.
    closed = ~np.isfinite(reward).any(axis=1)
    reward = reward.copy()
    reward[closed] = reward[np.isfinite(reward)].min()
    best = np.zeros(len(reward))
    for _ in range(_SWEEPS):
        values = reward + factor * best[child]
        improved = values.max(axis=1)
        if np.abs(improved - best).max() < _ACCURACY:
            break
        best = improved
    return values


SIZE = 16
"""Number of states of a group [-]."""
_WINDOW = 0.15  # largest distance of a group's states from its middle, at 0.12 m a decision [m]
_WALKERS, _STEPS = 96, 120
"""Number of walks along the ground, and their largest length in decisions [-]."""
_RANDOM = (0.0, 0.05, 0.1, 0.2)  # probabilities that a walk begins some equal random decisions [-]
_EQUAL = 6  # number of equal random decisions in a row that a walk stays below [-]


def sample_groups(
    graph: Graph,
    line: FloatArray,
    layout: ObservationLayout,
    rng: np.random.Generator,
    *,
    count: int,
    off_path: float,
    unseen: float,
    way: float,
) -> StateGroups:
    """Return ``count`` groups; a fraction ``off_path`` lies around any represented states.

    The others lie around states of walks that follow the best actions, with random ones between.
    In a fraction ``unseen`` of the groups the ground is level from a random bin ahead on.
    ``line``: the ground, (V, 2) [m]; ``way``: distance of a decision at full speed [m].
    """
    values = with_stops(graph.values)
    x = graph.nodes.places[:, 0]
    order = np.argsort(x, kind="stable")
    # Centres of groups: any state, or a state near the best way
    walked = _walks(graph, rng)
    anywhere = rng.integers(len(x), size=count)
    near = walked[rng.integers(len(walked), size=count)]
    centre = x[np.where(rng.random(count) < off_path, anywhere, near)]
    window = _WINDOW * way / 0.12
    # Half of each group comes from all states nearby, half from the walks.
    pools = (order, walked[np.argsort(x[walked], kind="stable")])
    members = np.empty((count, SIZE), np.int64)
    for half, pool in enumerate(pools):  # half of each group from each pool
        at = x[pool]
        low = np.searchsorted(at, centre - window)
        high = np.maximum(low + 1, np.searchsorted(at, centre + window))
        picked = low[:, None] + (rng.random((count, SIZE // 2)) * (high - low)[:, None]).astype(int)
        picked = np.minimum(picked, len(pool) - 1)
        members[:, half * SIZE // 2 : (half + 1) * SIZE // 2] = pool[picked]
    rows = members.ravel()
    nodes = graph.nodes.take(rows)
    seen = Ground(line, layout).observations(nodes.places, nodes.states)
    # What a student perceives there; in some groups it sees only a part of the ground.
    hidden = rng.random(count) < unseen
    first = np.where(hidden, rng.integers(layout.bins // 2 + 1, layout.bins, count), layout.bins)
    return StateGroups(
        observations=_levelled(seen, np.repeat(first, SIZE), layout).reshape(count, SIZE, -1),
        values=values[rows].astype(np.float32).reshape(count, SIZE, -1),
    )


def _levelled(
    seen: NDArray[np.float32], first: NDArray[np.int64], layout: ObservationLayout
) -> NDArray[np.float32]:
    """Return observations (M, n) whose heights from the bin ``first`` (M,) on are level."""
    bins = np.arange(layout.heights) % layout.bins
    last = seen[np.arange(len(seen)), first - 1]
    levelled = seen.copy()
    levelled[:, : layout.heights] = np.where(
        bins >= first[:, None], last[:, None], seen[:, : layout.heights]
    )
    return levelled


def with_stops(values: FloatArray) -> FloatArray:
    """Return values (M, 9) in which a turn beyond a stop has the value of not making it.

    Such a turn changes nothing. If both pairs are at a stop, neither turns.
    """
    filled = values.copy()
    for front, rear in ACTIONS:
        action = action_index(front, rear)
        for other in ((0, rear), (front, 0), (0, 0)):
            missing = ~np.isfinite(filled[:, action])
            filled[missing, action] = values[missing, action_index(*other)]
    return filled


def _walks(graph: Graph, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return the states of walks from the start, in which random actions persist."""
    best, x = graph.values.argmax(axis=1), graph.nodes.places[:, 0]
    starts = np.flatnonzero(x < x.min() + 1.0)
    at = rng.choice(starts, _WALKERS)
    share = rng.choice(_RANDOM, _WALKERS)
    left, action = np.zeros(_WALKERS, np.int64), np.zeros(_WALKERS, np.int64)
    seen = []
    for _ in range(_STEPS):
        # A walk begins some equal random decisions, after which it takes the best ones again.
        seen.append(at)
        begins = (left == 0) & (rng.random(len(at)) < share)
        left = np.where(begins, rng.integers(1, _EQUAL, len(at)), left)
        action = np.where(begins, rng.integers(len(ACTIONS), size=len(at)), action)
        random = (left > 0) & np.isfinite(graph.values[at, action])
        child = graph.child[at, np.where(random, action, best[at])]
        going = child >= 0
        at, share, action = child[going], share[going], action[going]
        left = np.maximum(0, left[going] - 1)
        if not len(at):
            break
    return np.concatenate(seen)


_EPISODE = Episode()
"""A ``Simulator`` does not tell its episode's own settings; values hold for the defaults."""


class ValueIterationPolicy:
    """Explores the ground of an episode, then takes the actions of the largest value."""

    def __init__(self, settings: ValueIterationSettings, rewards: Mapping[str, RewardTerm]) -> None:
        """Prepare for any episode."""
        self._settings, self._rewards = settings, RewardSum(rewards)
        self._rewards.require_predictable("rewards")

    def reset(self, simulator: Simulator) -> None:
        """Explore the ground."""
        compile_now()
        settings = self._settings
        p = simulator.perceive_exactly()
        simulator.restart()
        self._simulator, self._layout = simulator, p.layout
        robot = self._robot = nominal(p.robot)
        profile, state = simulator.profile, simulator.state
        # The prediction model on the true ground
        top = highest_at_finish(profile, robot, simulator.finish)
        self._model = Model(
            profile.points,
            robot,
            friction=settings.friction if p.friction is None else p.friction,
            step=settings.step,
            iterations=settings.iterations,
            overturn=_EPISODE.overturn,
            finish=simulator.finish,
            top=top,
            contacts=MOST_EXACT,
        )
        self._patience = _EPISODE.stuck_decisions(robot.decision_period)
        # The value of every state, which takes the time of the search
        start = float(state.position[0])
        course = Course(profile, start, simulator.finish, self._patience)
        self._graph = Graph(course, self._model, robot, self._rewards, settings.gamma)
        simulator.report_result(unexplored=self._graph.unexplored)
        # What the policy remembers of the episode
        self._targets = state.front, state.rear
        self._history = History()
        self._pending: int | None = None
        self._decided_at = state.time

    def act(self, p: Perception) -> int:
        """Return the action of the largest value in the true state."""
        action = int(self.costs(p).argmin())
        self.took(action)
        return action

    def costs(self, p: Perception) -> FloatArray:
        """Return the negative value of each action in the true state, (9,) [-]."""
        self._catch_up()
        settings, robot, root = self._settings, self._robot, self._here()
        # The true state differs from the one that represents it, so the first decisions are
        # searched.
        account = Returns(
            rewards=self._rewards,
            horizon=self._horizon,
            gamma=settings.gamma,
            profile=self._simulator.profile,
            robot=robot,
            nodes=root,
            begin=root.places[0, 0],
            standing=0,
            patience=self._patience,
        )
        search = Search(robot, settings.beam, settings.horizon, beam_per_action=1)
        costs = search.run(self._model, root.states[0], account).costs
        # A turn beyond a stop costs as much as not making it; an action without a plan costs the
        # most.
        costs = -with_stops(-costs[None])[0]
        return np.asarray(np.where(np.isfinite(costs), costs, costs[np.isfinite(costs)].max()))

    def took(self, action: int) -> None:
        """Remember the action that was taken."""
        robot, state = self._robot, self._simulator.state
        self._targets = next_targets(robot, self._targets, (state.front, state.rear), action)
        self._history.took(action, robot.decision_period)
        self._pending, self._decided_at = action, state.time

    def _catch_up(self) -> None:
        """Repeat the last action in the simulator, unless whoever asked for it has done so."""
        if self._pending is not None and self._simulator.state.time == self._decided_at:
            self._simulator.step(self._pending)
        self._pending = None

    def groups(self, rng: np.random.Generator) -> StateGroups:
        """Return groups of states of the episode's ground with the values of their actions."""
        settings, robot = self._settings, self._robot
        return sample_groups(
            self._graph,
            self._simulator.profile.extended(3.0, 3.0),
            self._layout,
            rng,
            count=settings.groups,
            off_path=settings.off_path,
            unseen=settings.unseen,
            way=robot.track_speed * robot.decision_period,
        )

    def _horizon(self, nodes: Nodes) -> FloatArray:
        """Return the values of the states that represent ``nodes``, (M,) [-]."""
        rows = self._graph.lookup(nodes)
        best = self._graph.best
        return np.asarray(np.where(rows < 0, best.min(), best[rows]))

    def _here(self) -> Nodes:
        """Return the true state as a node."""
        state = self._simulator.state
        self._history.saw(state.pitch)
        angles = state.front, state.rear
        targets = next_targets(self._robot, self._targets, angles, HOLD)
        return self._history.node(self._model.known(state, targets), state.position)
