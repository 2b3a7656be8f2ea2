"""A beam search over flipper commands on the ground around the robot.

In: the robot's present state on a piece of ground, and the prices. Out: the cheapest sequence of
actions, and the price of the best sequence that begins with each action.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import ACTIONS, FloatArray, Robot, action_index
from flipperctl.lookahead.model import TARGETS, Branch, Model

HOLD = action_index(0, 0)
_TURNS = np.array(ACTIONS, dtype=np.float64)
_CELL = np.array([0.03, 0.03, 0.03, 0.1, 0.1])
"""Nodes whose x, z [m], pitch and flipper targets [rad] fall into one cell are merged."""
HURRY = 5.0
"""Divisor of the price of swing in a hurry [-]. A third of the beam is chosen at that price, so
that plans that climb survive beside plans that wait."""


@dataclass(frozen=True)
class Prices:
    """What a plan costs, in seconds."""

    swing: float
    """Price of the pitch variation [s/rad]."""
    pitch: float
    """Price of the absolute pitch at the horizon, from which the chassis must return [s/rad]."""
    lean: float
    """Price of the absolute pitch after each decision [s/rad]."""
    flippers: float
    """Price of each absolute flipper angle after each decision [s/rad]."""
    turn: float
    """Price of turning a flipper pair in one decision [s]."""
    standstill: float
    """Further price of time lost beyond ``standstill_from`` [s/s]."""
    standstill_from: float
    """Time lost from which a plan counts as standing [s]."""
    steep: float
    """Price of the largest pitch of a plan beyond ``steep_from`` [s/rad]."""
    steep_from: float
    """Pitch from which steepness costs, short of overturning [rad]."""


@dataclass(frozen=True)
class Plan:
    """The result of a search."""

    actions: tuple[int, ...]
    """Indices into ``ACTIONS`` of the cheapest plan; fewer than the horizon if every longer plan
    overturns the robot or the time is up."""
    states: FloatArray
    """State before the plan and after each action, (len(actions) + 1, ``STATE``)."""
    late: float
    """Time lost by the plan against driving its duration at full speed [s]."""
    costs: FloatArray
    """Price of the best plan that begins with each action, (9,) [s]; inf where none survived."""
    simulated: int
    """Number of simulated decisions [-]."""


@dataclass(frozen=True)
class _Level:
    """The nodes of one depth, cheapest first."""

    states: FloatArray
    swing: FloatArray
    """Pitch variation from the root [rad]."""
    paid: FloatArray
    """Price of postures and turns from the root [s]."""
    steep: FloatArray
    """Largest absolute pitch from the root [rad]."""
    first: NDArray[np.int64]
    """First action of each node's plan."""
    parent: NDArray[np.int64]
    """Index of each node's parent in the level above."""
    action: NDArray[np.int64]
    """Action that led to each node."""
    seed: int
    """Index of the node of the former plan, or -1."""


@dataclass(frozen=True)
class Search:
    """A search of one size; ``run`` does not depend on earlier runs."""

    robot: Robot
    prices: Prices
    width: int
    """Nodes that are kept at each depth."""
    depth: int
    """Decisions to the horizon."""
    of_each: int = 0
    """Nodes that are kept at each depth for each first action, however expensive, so that every
    action's cost is known and not the best one's alone."""

    def run(
        self,
        model: Model,
        root: FloatArray,
        former: tuple[int, ...] = (),
        deadline: float = math.inf,
    ) -> Plan:
        """Return the cheapest plan from the state ``root``, (``STATE``,).

        The plan ``former`` is kept in the beam, however expensive it is on the way. After the time
        ``deadline`` of ``time.perf_counter`` the search ends at the depth that it has reached.
        """
        robot, prices = self.robot, self.prices
        begin, _ = model.chassis(root)
        zero, none = np.zeros(1), np.array([-1])
        levels = [_Level(root[None], zero, zero, zero, none, none, none, 0)]
        costs = np.full(len(ACTIONS), np.inf)
        late = np.zeros(1)
        simulated = 0
        for step in range(self.depth):
            here = levels[-1]
            parent, action, targets = moves(here.states[:, TARGETS:], robot)
            found = model.expand(here.states[parent], targets, robot.decision_period)
            simulated += len(parent)
            first = action if step == 0 else here.first[parent]
            swing = here.swing[parent] + found.swing
            paid = here.paid[parent] + _way(found.states, action, prices)
            steep = np.maximum(here.steep[parent], found.steepest)
            distance = found.places[:, 0] - begin
            lost = robot.decision_period * (step + 1) - distance / robot.track_speed
            lost = np.maximum(lost, 0.0)  # else plans would flap along on their flippers
            rest = paid + _end(found.states, lost, steep, prices)
            cost = rest + prices.swing * swing
            alive = found.steepest < model.overturn
            if not alive.any():
                if step:
                    break
                alive = found.steepest == found.steepest.min()  # as far from falling as possible
            follows = np.flatnonzero(
                alive
                & (parent == here.seed)
                & (action == (former[step] if step < len(former) else HOLD))
            )
            hurried = rest + prices.swing / HURRY * swing
            kept = self._keep(found, (cost, hurried), first, alive, follows)
            seed = int(np.flatnonzero(kept == follows[0])[0]) if len(follows) else -1
            late = lost[kept]
            costs = np.full(len(ACTIONS), np.inf)
            np.minimum.at(costs, first[alive], cost[alive])
            levels.append(
                _Level(
                    *(found.states[kept], swing[kept], paid[kept], steep[kept]),
                    *(first[kept], parent[kept], action[kept], seed),
                )
            )
            if time.perf_counter() > deadline:
                break
        return _trace(levels, float(late[0]), costs, simulated)

    def _keep(
        self,
        found: Branch,
        costs: tuple[FloatArray, FloatArray],
        first: NDArray[np.int64],
        alive: NDArray[np.bool_],
        follows: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """Return the indices of the nodes of the next level, cheapest first.

        ``costs``: of each node, at the normal prices and in a hurry.
        """
        cost, hurried = costs
        rows = np.flatnonzero(alive)
        rows = rows[np.argsort(cost[rows], kind="stable")]
        rows = rows[_distinct(found, rows)]
        quick = rows[np.argsort(hurried[rows], kind="stable")][: self.width // 3]
        calm = rows[~np.isin(rows, quick)][: self.width - len(quick)]
        kept = np.concatenate([calm, quick, follows])
        if self.of_each:
            every = [rows[first[rows] == action][: self.of_each] for action in range(len(ACTIONS))]
            kept = np.concatenate([kept, *every])
        kept = np.unique(kept)
        return kept[np.argsort(cost[kept], kind="stable")]


def moves(
    targets: FloatArray, robot: Robot
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Return node, action and new targets of every move that turns no flipper against its stop."""
    turned = targets[:, None, :] + _TURNS * robot.angle_step  # (M, 9, 2)
    beyond = np.abs(turned) > robot.angle_limit + 0.5 * robot.angle_step
    node, action = np.nonzero(~(beyond & (_TURNS != 0)).any(axis=2))
    return node, action, np.clip(turned[node, action], -robot.angle_limit, robot.angle_limit)


def _way(states: FloatArray, action: NDArray[np.int64], prices: Prices) -> FloatArray:
    """Return the price of the postures after one decision and of the turns in it, (M,) [s]."""
    return np.asarray(
        prices.flippers * np.abs(states[:, TARGETS:]).sum(axis=1)
        + prices.lean * np.abs(states[:, 2])
        + prices.turn * np.abs(_TURNS[action]).sum(axis=1)
    )


def _end(states: FloatArray, late: FloatArray, steep: FloatArray, prices: Prices) -> FloatArray:
    """Return the price of time and of the end of plans, (M,) [s]."""
    return np.asarray(
        late
        + prices.standstill * np.maximum(0.0, late - prices.standstill_from)
        + prices.pitch * np.abs(states[:, 2])
        + prices.steep * np.maximum(0.0, steep - prices.steep_from)
    )


def _distinct(found: Branch, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the index of the first of the ``rows`` in each cell, in their order."""
    states = found.states[rows]
    keys = np.column_stack([found.places[rows], states[:, 2], states[:, TARGETS:]]) / _CELL
    _, index = np.unique(np.round(keys).astype(np.int64), axis=0, return_index=True)
    return np.sort(index)


def _trace(levels: list[_Level], late: float, costs: FloatArray, simulated: int) -> Plan:
    actions: list[int] = []
    states: list[FloatArray] = []
    node = 0
    for level in reversed(levels[1:]):
        actions.append(int(level.action[node]))
        states.append(level.states[node])
        node = int(level.parent[node])
    states.append(levels[0].states[0])
    return Plan(tuple(actions[::-1]), np.array(states[::-1]), late, costs, simulated)
