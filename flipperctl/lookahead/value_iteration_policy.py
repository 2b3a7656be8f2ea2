"""The policy of ``value_iteration``: it knows the ground, and the value of every state on it.

In: the simulator of an episode. Out: the actions of the largest return, their values, and groups of
states that lie close to each other, from which a student learns. A student that sees a metre of the
ground cannot know what comes after; states of one group share it, so that their differences are
what the student can learn.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    ACTIONS,
    FloatArray,
    ObservationLayout,
    Perception,
    RewardTerm,
    Simulator,
    StateGroups,
    action_index,
)
from flipperctl.config import Episode
from flipperctl.core.targets import TargetRule
from flipperctl.lookahead.dynamics import MOST_EXACT
from flipperctl.lookahead.graph import Course, Graph
from flipperctl.lookahead.model import TARGETS, Ground, Model, Nodes, compile_now
from flipperctl.lookahead.mpc_policy import nominal
from flipperctl.lookahead.returns import History, Returns
from flipperctl.lookahead.search import Search, highest_at_finish
from flipperctl.lookahead.settings import ValueIterationSettings
from flipperctl.reward_sum import RewardSum

SIZE = 16
"""Number of states of a group [-]."""
_WINDOW = 0.15
"""Largest distance of a group's states from its middle, at 0.12 m a decision [m]."""
_WALKERS, _STEPS = 96, 120
"""Number of walks along the ground, and their largest length in decisions [-]."""
_RANDOM = (0.0, 0.05, 0.1, 0.2)
"""Probabilities that a walk begins some equal random decisions [-]."""
_EQUAL = 6
"""Number of equal random decisions in a row that a walk stays below [-]."""


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
    """Return ``count`` groups, a fraction ``off_path`` of them around any represented states.

    The others lie around states of walks that follow the best actions, with random ones between.
    In a fraction ``unseen`` of the groups the ground is level from a random bin ahead on.
    ``line``: the ground, (V, 2) [m]; ``way``: distance of a decision at full speed [m].
    """
    values = with_stops(graph.values)
    x = graph.nodes.places[:, 0]
    order = np.argsort(x, kind="stable")
    walked = _walks(graph, rng)
    anywhere = rng.integers(len(x), size=count)
    near = walked[rng.integers(len(walked), size=count)]
    centre = x[np.where(rng.random(count) < off_path, anywhere, near)]
    window = _WINDOW * way / 0.12
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
    hidden = rng.random(count) < unseen
    first = np.where(hidden, rng.integers(layout.bins // 2 + 1, layout.bins, count), layout.bins)
    return StateGroups(
        observations=_levelled(seen, np.repeat(first, SIZE), layout).reshape(count, SIZE, -1),
        values=values[rows].astype(np.float32).reshape(count, SIZE, -1),
    )


def _levelled(
    seen: NDArray[np.float32], first: NDArray[np.int64], layout: ObservationLayout
) -> NDArray[np.float32]:
    """Return observations (M, N + 3) whose heights from the bin ``first`` (M,) on are level."""
    bins = np.arange(layout.bins)
    last = seen[np.arange(len(seen)), first - 1]
    found = seen.copy()
    found[:, : layout.bins] = np.where(
        bins >= first[:, None], last[:, None], seen[:, : layout.bins]
    )
    return found


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
        seen.append(at)
        begins = (left == 0) & (rng.random(len(at)) < share)
        left = np.where(begins, rng.integers(1, _EQUAL, len(at)), left)
        action = np.where(begins, rng.integers(len(ACTIONS), size=len(at)), action)
        chosen = np.where((left > 0) & np.isfinite(graph.values[at, action]), action, best[at])
        child = graph.child[at, chosen]
        going = child >= 0
        at, share, action = child[going], share[going], action[going]
        left = np.maximum(0, left[going] - 1)
        if not len(at):
            break
    return np.concatenate(seen)


_EPISODE = Episode()
"""A ``Simulator`` does not tell its episode's own settings; values are those of the defaults."""


class OraclePolicy:
    """Explores the ground of an episode, then takes the actions of the largest value."""

    def __init__(self, settings: ValueIterationSettings, rewards: Mapping[str, RewardTerm]) -> None:
        """Prepare for any episode.

        Raises:
            ConfigError: a reward term needs what predictions lack.
        """
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
        course = Course(
            profile,
            start=float(state.position[0]),
            finish=simulator.finish,
            patience=self._patience,
        )
        self._graph = Graph(course, self._model, robot, self._rewards, settings.gamma)
        simulator.report_result(unexplored=self._graph.unexplored)
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
        objective = Returns(
            rewards=self._rewards,
            horizon=self._horizon,
            gamma=settings.gamma,
            profile=self._simulator.profile,
            robot=robot,
            root=root,
            standing=0,
            patience=self._patience,
        )
        search = Search(
            robot,
            objective,
            width=settings.beam,
            depth=settings.horizon,
            beam_per_action=1,
        )
        costs = search.run(self._model, root.states[0]).costs
        costs = -with_stops(-costs[None])[0]
        return np.asarray(np.where(np.isfinite(costs), costs, costs[np.isfinite(costs)].max()))

    def took(self, action: int) -> None:
        """Remember the action that was taken."""
        robot, state = self._robot, self._simulator.state
        turns = [turn * robot.angle_step for turn in ACTIONS[action]]
        rule = TargetRule(robot.angle_step, robot.angle_limit)
        self._targets = rule.next_targets(self._targets, (state.front, state.rear), turns)
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
        found = self._graph.lookup(nodes)
        best = self._graph.best
        return np.asarray(np.where(found < 0, best.min(), best[found]))

    def _here(self) -> Nodes:
        """Return the true state as a node."""
        state, robot = self._simulator.state, self._robot
        self._history.saw(state.pitch)
        x, z = state.position
        found = self._model.state(
            (float(x), float(z), state.pitch),
            (state.front, state.rear),
            (float(state.velocity[0]), float(state.velocity[1]), state.pitch_rate),
        )
        rule = TargetRule(robot.angle_step, robot.angle_limit)
        found[TARGETS:] = rule.next_targets(self._targets, (state.front, state.rear), (0.0, 0.0))
        return self._history.node(found, state.position)
