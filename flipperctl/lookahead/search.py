"""A beam search over flipper commands on the ground around the robot.

In: the robot's present state on a piece of ground, and an account of what plans cost. Out: the
cheapest sequence of actions, and the cost of the best sequence that begins with each action.
``Returns`` is the negative discounted return of reward terms and of a value at the horizon; ``mpc``
has a hand-set cost too.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    ACTIONS,
    LAST_PITCHES,
    FloatArray,
    Outcome,
    Profile,
    Robot,
    RobotGeometry,
    action_index,
)
from flipperctl.config import Episode
from flipperctl.config.reward_sum import RewardSum
from flipperctl.lookahead.dynamics import RUNNING
from flipperctl.lookahead.model import FLIPPERS, TARGETS, TURNS, Branch, Model, Nodes, transitions

_CLEARANCE = Episode().clearance
"""Largest height of the chassis' higher end above the ground at the finish [m].

A ``Simulator`` does not tell its episode's own ``clearance``, so plans aim at the default; the
episode decides whether a trajectory has reached the finish."""


def highest_at_finish(profile: Profile, robot: RobotGeometry, finish: float) -> float:
    """Return the largest world z of the chassis' higher end at the ``finish``, world x [m].

    It is infinite where the ground goes on, on a slope or a stair; the episode compares the chassis
    with a resting one there.
    """
    if finish < profile.end:
        return math.inf
    return profile.height(finish) + robot.track_radius + _CLEARANCE


HOLD = action_index(0, 0)
_CELL = np.array([0.03, 0.03, 0.03])
"""Nodes whose x, z [m] and pitch [rad] fall into one cell, and their targets, are merged."""

_EQUAL = 1e-6  # difference of costs up to which plans that end the episode count as equal


class Scores(NamedTuple):
    """The costs of M plans that are one decision longer than before, in the objective's unit."""

    cost: FloatArray
    """Cost of each plan, with an estimate of what follows its end."""
    hurried: FloatArray
    """Cost by which a third of the beam is chosen, so that plans that climb survive beside plans
    that wait."""
    ended: NDArray[np.bool_]
    """Whether the episode ends here, so that the cost is final."""
    lost_time: FloatArray
    """Time lost by each plan compared with driving at full speed [s]."""
    account: Account
    """What the plans have cost so far."""


class Account(Protocol):
    """What the plans of a level's nodes have cost so far; it says what a search minimises."""

    @property
    def poses(self) -> bool:
        """Whether the poses between two decisions are needed."""

    def extend(
        self, parent: NDArray[np.int64], action: NDArray[np.int64], branch: Branch
    ) -> Scores:
        """Return the scores of longer plans: ``action`` (M,) from the nodes ``parent`` (M,)."""

    def take(self, rows: NDArray[np.int64]) -> Account:
        """Return the account of some of the nodes."""


@dataclass(frozen=True)
class Plan:
    """The result of a search."""

    actions: tuple[int, ...]
    """Indices into ``ACTIONS`` of the cheapest plan; fewer than the horizon if every longer plan
    overturns the robot or the deadline has passed."""
    states: FloatArray
    """State before the plan and after each action, (len(actions) + 1, ``STATE``)."""
    lost_time: float
    """Time lost by the plan compared with driving at full speed [s]."""
    costs: FloatArray
    """Cost of the best plan that begins with each action, (9,), in the objective's unit; inf where
    none survived."""
    simulated: int
    """Number of simulated decisions [-]."""


class Planned(NamedTuple):
    """What a policy plans to do, for viewers: its attribute ``planned``."""

    actions: tuple[int, ...]
    """Indices into ``ACTIONS`` of the next K decisions."""
    path: FloatArray
    """Predicted places of the chassis centre, from the present one, (K + 1, 2): x, z [m]."""


@dataclass(frozen=True)
class _Level:
    """The nodes of one depth, cheapest first."""

    states: FloatArray
    account: Account
    first: NDArray[np.int64]  # first action of each node's plan
    parent: NDArray[np.int64]  # index of each node's parent in the previous level
    action: NDArray[np.int64]  # action that led to each node
    lost_time: FloatArray
    seed: int  # index of the node that follows the previous plan, or -1


@dataclass(frozen=True)
class Search:
    """A search of one size; no run depends on an earlier one."""

    robot: Robot
    width: int  # nodes that are kept at each depth
    depth: int  # decisions to the horizon
    beam_per_action: int = 0
    """Nodes that are kept at each depth for each first action, whatever their cost, so that the
    cost of every action is known."""

    def run(
        self,
        model: Model,
        root: FloatArray,
        account: Account,
        former: tuple[int, ...] = (),
        deadline: float = math.inf,
    ) -> Plan:
        """Return the cheapest plan from the state ``root``, (``STATE``,).

        ``account``: account of the root. The plan ``former`` stays in the beam whatever its cost.
        Once ``time.perf_counter`` passes ``deadline`` [s], the search ends at its depth of then.
        """
        robot, poses, none = self.robot, account.poses, np.array([-1])
        levels = [_Level(root[None], account, none, none, none, np.zeros(1), 0)]
        costs, best = np.full(len(ACTIONS), np.inf), math.inf
        final, least = np.full(len(ACTIONS), np.inf), math.inf
        ended: tuple[tuple[int, ...], FloatArray, float] | None = None  # the cheapest such plan
        simulated = 0
        for step in range(self.depth):
            here = levels[-1]
            # All moves from the nodes of this depth
            parent, action, targets = moves(here.states, robot)
            branch = model.expand(here.states[parent], targets, robot.decision_period, poses=poses)
            simulated += len(parent)
            first = action if step == 0 else here.first[parent]
            scores = here.account.extend(parent, action, branch)
            cost = scores.cost
            # A plan that ends the episode is complete; the cheapest one is remembered.
            if len(rows := np.flatnonzero(scores.ended)):
                np.minimum.at(final, first[rows], cost[rows])
                # Of equal plans the one that holds, or flippers drift on level ground.
                holds = action[rows] == HOLD
                row = rows[(cost[rows] - _EQUAL * holds).argmin()]
                if ended is None or cost[row] < least:
                    actions, states = _trace(levels, int(parent[row]))
                    actions, states = (*actions, int(action[row])), [*states, branch.states[row]]
                    ended = actions, np.array(states), float(scores.lost_time[row])
                    least = float(cost[row])
            # Other plans go on unless the robot overturns.
            alive = ~scores.ended & (branch.steepest < model.overturn)
            if not alive.any():
                if step or ended is not None:
                    break
                alive = branch.steepest == branch.steepest.min()  # as far from falling as possible
            # The former plan's next node stays in the beam at any cost.
            follows = np.flatnonzero(
                alive
                & (parent == here.seed)
                & (action == (former[step] if step < len(former) else HOLD))
            )
            beam = self._keep(branch, (cost, scores.hurried), first, alive, follows)
            seed = int(np.flatnonzero(beam == follows[0])[0]) if len(follows) else -1
            # Costs of first actions hold for this depth alone, since longer plans cost more.
            costs, best = np.full(len(ACTIONS), np.inf), float(cost[beam[0]])
            np.minimum.at(costs, first[alive], cost[alive])
            levels.append(
                _Level(
                    states=branch.states[beam],
                    account=scores.account.take(beam),
                    first=first[beam],
                    parent=parent[beam],
                    action=action[beam],
                    lost_time=scores.lost_time[beam],
                    seed=seed,
                )
            )
            if time.perf_counter() > deadline:
                break
        # A plan that ends the episode wins if all that go on cost more.
        if ended is None or not (least < best or len(levels) == 1):
            actions, states = _trace(levels, 0)
            ended = actions, np.array(states), float(levels[-1].lost_time[0])
        return Plan(*ended, np.minimum(costs, final), simulated)

    def _keep(
        self,
        branch: Branch,
        costs: tuple[FloatArray, FloatArray],
        first: NDArray[np.int64],
        alive: NDArray[np.bool_],
        follows: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """Return the indices of the nodes of the next level, cheapest first.

        ``costs``: costs of each node with the normal weights and in a hurry, in the objective's
        unit.
        """
        cost, hurried = costs
        rows = np.flatnonzero(alive)
        rows = rows[np.argsort(cost[rows], kind="stable")]
        rows = rows[_distinct(branch, rows, self.robot)]
        # A third of the beam goes to plans that gain the most way.
        quick = rows[np.argsort(hurried[rows], kind="stable")][: self.width // 3]
        calm = rows[~np.isin(rows, quick)][: self.width - len(quick)]
        beam = np.concatenate([calm, quick, follows])
        # Each first action keeps some nodes of its own.
        if count := self.beam_per_action:
            each = [rows[first[rows] == action][:count] for action in range(len(ACTIONS))]
            beam = np.concatenate([beam, *each])
        beam = np.unique(beam)
        return beam[np.argsort(cost[beam], kind="stable")]


def moves(
    states: FloatArray, robot: Robot
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Return node, action and new targets of every move that stays within the flippers' stops.

    ``states`` (M, ``STATE``). Targets begin at most one angle step from the flippers, as the
    robot's do (``core.targets``).
    """
    angles, targets = states[:, FLIPPERS:TARGETS], states[:, TARGETS:]
    targets = np.clip(targets, angles - robot.angle_step, angles + robot.angle_step)
    turned = targets[:, None, :] + TURNS * robot.angle_step  # (M, 9, 2)
    # A rest of more than half a step up to the stop counts as a turn; it is cut there.
    beyond = np.abs(turned) > robot.angle_limit + 0.5 * robot.angle_step
    node, action = np.nonzero(~(beyond & (TURNS != 0)).any(axis=2))
    return node, action, np.clip(turned[node, action], -robot.angle_limit, robot.angle_limit)


def target_cell(robot: Robot) -> float:
    """Return the difference below which flipper targets of plans count as equal [rad]."""
    return min(0.1, 0.5 * robot.angle_step)


def _distinct(branch: Branch, rows: NDArray[np.int64], robot: Robot) -> NDArray[np.int64]:
    """Return the position of the first of ``rows`` in each cell, in ascending order."""
    states, cell = branch.states[rows], [*_CELL, *2 * [target_cell(robot)]]
    keys = np.column_stack([branch.places[rows], states[:, 2], states[:, TARGETS:]]) / cell
    _, index = np.unique(np.round(keys).astype(np.int64), axis=0, return_index=True)
    return np.sort(index)


def _trace(levels: list[_Level], node: int) -> tuple[tuple[int, ...], list[FloatArray]]:
    """Return the actions and the states that lead to a ``node`` of the last level."""
    actions: list[int] = []
    states: list[FloatArray] = []
    for level in reversed(levels[1:]):
        actions.append(int(level.action[node]))
        states.append(level.states[node])
        node = int(level.parent[node])
    states.append(levels[0].states[0])
    return tuple(actions[::-1]), states[::-1]


class History:
    """The last pitches, the last turns, and the time since the start."""

    def __init__(self) -> None:
        self._pitches: list[float] = []
        self._turns = 0, 0
        self._time = 0.0

    def saw(self, pitch: float) -> None:
        """Remember the pitch at a decision [rad]."""
        self._pitches = [*self._pitches, pitch][-LAST_PITCHES:]

    def took(self, action: int, period: float) -> None:
        """Remember an action and its ``period`` [s]."""
        self._turns = ACTIONS[action]
        self._time += period

    def node(self, state: FloatArray, place: FloatArray) -> Nodes:
        """Return the robot in a state of the prediction model, (``STATE``,), at x and z [m]."""
        return Nodes(
            states=state[None],
            places=place[None],
            pitches=np.array([self._pitches]),
            turns=np.array([self._turns]),
            time=np.array([self._time]),
        )


def none_yet() -> FloatArray:
    """Return what the plan of the root alone has cost, (1,)."""
    return np.zeros(1)


_SLOW = 0.3  # share of the way at full speed below which a plan stands [-]


@dataclass(frozen=True, kw_only=True)
class Returns:
    """The discounted reward of the plans of M nodes, by which a search minimises its negative."""

    rewards: RewardSum
    horizon: Callable[[Nodes], FloatArray]
    """Returns the expected discounted return from nodes on, (M,) [-]."""
    gamma: float  # discount per decision [-]
    profile: Profile  # the known ground
    robot: Robot
    nodes: Nodes
    standing: int  # number of decisions in which the robot has stood until now
    patience: int
    """Number of decisions without progress after which an episode ends as stuck [-]."""
    averaging: float = 0.0
    """Share of the estimates at smaller depths in the return of a plan, 0 to 1. The best of many
    plans is often the one whose value errs most; its errors at several depths average out."""
    poses: bool = True  # reward terms see those between decisions
    begin: float  # x of the chassis centre at the root [m]
    depth: int = 0  # number of decisions from the root
    earned: FloatArray = field(default_factory=none_yet)
    """Discounted rewards from the root, (M,) [-]."""
    estimate: FloatArray = field(default_factory=none_yet)  # return of the plans, (M,) [-]

    def take(self, rows: NDArray[np.int64]) -> Returns:
        """Return the account of some of the nodes."""
        return replace(
            self,
            nodes=self.nodes.take(rows),
            earned=self.earned[rows],
            estimate=self.estimate[rows],
        )

    def extend(
        self, parent: NDArray[np.int64], action: NDArray[np.int64], branch: Branch
    ) -> Scores:
        """Return the scores of plans that are one decision longer."""
        period = self.robot.decision_period
        # Rewards of this decision, and the value of what follows unless the episode ends
        before = self.nodes.take(parent)
        after = before.after(branch, action, period)
        ts = transitions(before, after, branch, self.profile, self.robot)
        reward = self.rewards.array(ts)
        ended = branch.outcome != RUNNING
        ahead = np.zeros(len(parent))
        going = np.flatnonzero(~ended)
        ahead[going] = self.horizon(after.take(going))
        distance = branch.places[:, 0] - self.begin
        way = self.robot.track_speed * period * (self.depth + 1)
        if self.standing:
            # The longer the robot has stood, the likelier the episode ends before it moves. The
            # value does not know how long it has stood.
            rows = np.flatnonzero(~ended & (distance < _SLOW * way))
            risk = min(1.0, (self.standing + self.depth + 1) / self.patience)
            if len(rows):
                stuck = self.rewards.array(ts.ending(rows, Outcome.STUCK))
                reward[rows] += risk * (stuck - reward[rows])
                ahead[rows] *= 1.0 - risk
        # Discounted return from the root
        discount = self.gamma**self.depth
        earned = self.earned[parent] + discount * reward
        estimate = earned + discount * self.gamma * ahead
        # Errors of the value at several depths average out.
        if self.depth and self.averaging:
            mixed = self.averaging * self.estimate[parent] + (1 - self.averaging) * estimate
            estimate = np.where(ended, estimate, mixed)
        lost = period * (self.depth + 1) - distance / self.robot.track_speed
        account = replace(self, nodes=after, depth=self.depth + 1, earned=earned, estimate=estimate)
        return Scores(-estimate, -distance, ended, np.maximum(0.0, lost), account)
