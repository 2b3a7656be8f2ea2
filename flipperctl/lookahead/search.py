"""A beam search over flipper commands on the ground around the robot.

In: the robot's present state on a piece of ground, and cost weights. Out: the cheapest sequence of
actions, and the cost of the best sequence that begins with each action.
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
"""Divisor of the cost weight of pitch variation in a hurry [-]. A third of the beam is chosen with
the smaller weight, so that plans that climb survive beside plans that wait."""


@dataclass(frozen=True)
class CostWeights:
    """Weights of the terms of a plan's cost, which is in seconds."""

    pitch_variation: float
    """Weight of the pitch variation [s/rad]."""
    pitch: float
    """Weight of the absolute pitch at the horizon [s/rad]."""
    lean: float
    """Weight of the absolute pitch after each decision [s/rad]."""
    flippers: float
    """Weight of each absolute flipper angle after each decision [s/rad]."""
    turn: float
    """Cost of turning a flipper pair in one decision [s]."""
    standstill: float
    """Additional weight of time lost beyond ``standstill_from`` [s/s]."""
    standstill_from: float
    """Lost time from which a plan counts as standing still [s]."""
    steep: float
    """Weight of the largest pitch of a plan beyond ``steep_from`` [s/rad]."""
    steep_from: float
    """Pitch above which a plan is charged for steepness, below overturning [rad]."""


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
    """Cost of the best plan that begins with each action, (9,) [s]; inf where none survived."""
    simulated: int
    """Number of simulated decisions [-]."""


@dataclass(frozen=True)
class _Level:
    """The nodes of one depth, cheapest first."""

    states: FloatArray
    variation: FloatArray
    """Pitch variation from the root [rad]."""
    paid: FloatArray
    """Cost of postures and turns from the root [s]."""
    steep: FloatArray
    """Largest absolute pitch from the root [rad]."""
    first: NDArray[np.int64]
    """First action of each node's plan."""
    parent: NDArray[np.int64]
    """Index of each node's parent in the previous level."""
    action: NDArray[np.int64]
    """Action that led to each node."""
    seed: int
    """Index of the node that follows the previous plan, or -1."""


@dataclass(frozen=True)
class Search:
    """A search of one size; no run depends on an earlier one."""

    robot: Robot
    weights: CostWeights
    width: int
    """Nodes that are kept at each depth."""
    depth: int
    """Decisions to the horizon."""
    beam_per_action: int = 0
    """Nodes that are kept at each depth for each first action, whatever their cost, so that the
    cost of every action is known."""

    def run(
        self,
        model: Model,
        root: FloatArray,
        former: tuple[int, ...] = (),
        deadline: float = math.inf,
    ) -> Plan:
        """Return the cheapest plan from the state ``root``, (``STATE``,).

        The plan ``former`` is kept in the beam whatever its cost. Once ``time.perf_counter`` passes
        ``deadline`` [s], the search ends at the depth that it has reached.
        """
        robot, weights = self.robot, self.weights
        begin, _ = model.chassis(root)
        zero, none = np.zeros(1), np.array([-1])
        levels = [_Level(root[None], zero, zero, zero, none, none, none, 0)]
        costs = np.full(len(ACTIONS), np.inf)
        lost_time = np.zeros(1)
        simulated = 0
        for step in range(self.depth):
            here = levels[-1]
            parent, action, targets = moves(here.states[:, TARGETS:], robot)
            found = model.expand(here.states[parent], targets, robot.decision_period)
            simulated += len(parent)
            first = action if step == 0 else here.first[parent]
            variation = here.variation[parent] + found.pitch_variation
            paid = here.paid[parent] + _step_cost(found.states, action, weights)
            steep = np.maximum(here.steep[parent], found.steepest)
            distance = found.places[:, 0] - begin
            lost = robot.decision_period * (step + 1) - distance / robot.track_speed
            lost = np.maximum(lost, 0.0)  # otherwise plans would push themselves along by flippers
            rest = paid + _final_cost(found.states, lost, steep, weights)
            cost = rest + weights.pitch_variation * variation
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
            hurried = rest + weights.pitch_variation / HURRY * variation
            kept = self._keep(found, (cost, hurried), first, alive, follows)
            seed = int(np.flatnonzero(kept == follows[0])[0]) if len(follows) else -1
            lost_time = lost[kept]
            costs = np.full(len(ACTIONS), np.inf)
            np.minimum.at(costs, first[alive], cost[alive])
            levels.append(
                _Level(
                    *(found.states[kept], variation[kept], paid[kept], steep[kept]),
                    *(first[kept], parent[kept], action[kept], seed),
                )
            )
            if time.perf_counter() > deadline:
                break
        return _trace(levels, float(lost_time[0]), costs, simulated)

    def _keep(
        self,
        found: Branch,
        costs: tuple[FloatArray, FloatArray],
        first: NDArray[np.int64],
        alive: NDArray[np.bool_],
        follows: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """Return the indices of the nodes of the next level, cheapest first.

        ``costs``: costs of each node with the normal weights and in a hurry [s].
        """
        cost, hurried = costs
        rows = np.flatnonzero(alive)
        rows = rows[np.argsort(cost[rows], kind="stable")]
        rows = rows[_distinct(found, rows)]
        quick = rows[np.argsort(hurried[rows], kind="stable")][: self.width // 3]
        calm = rows[~np.isin(rows, quick)][: self.width - len(quick)]
        kept = np.concatenate([calm, quick, follows])
        if count := self.beam_per_action:
            every = [rows[first[rows] == action][:count] for action in range(len(ACTIONS))]
            kept = np.concatenate([kept, *every])
        kept = np.unique(kept)
        return kept[np.argsort(cost[kept], kind="stable")]


def moves(
    targets: FloatArray, robot: Robot
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Return node, action and new targets of every move that stays within the flippers' stops."""
    turned = targets[:, None, :] + _TURNS * robot.angle_step  # (M, 9, 2)
    beyond = np.abs(turned) > robot.angle_limit + 0.5 * robot.angle_step
    node, action = np.nonzero(~(beyond & (_TURNS != 0)).any(axis=2))
    return node, action, np.clip(turned[node, action], -robot.angle_limit, robot.angle_limit)


def _step_cost(states: FloatArray, action: NDArray[np.int64], weights: CostWeights) -> FloatArray:
    """Return the cost of the turns in one decision and of the postures after it, (M,) [s]."""
    return np.asarray(
        weights.flippers * np.abs(states[:, TARGETS:]).sum(axis=1)
        + weights.lean * np.abs(states[:, 2])
        + weights.turn * np.abs(_TURNS[action]).sum(axis=1)
    )


def _final_cost(
    states: FloatArray, lost: FloatArray, steep: FloatArray, weights: CostWeights
) -> FloatArray:
    """Return the cost of lost time, largest pitch and final pitch of plans, (M,) [s]."""
    return np.asarray(
        lost
        + weights.standstill * np.maximum(0.0, lost - weights.standstill_from)
        + weights.pitch * np.abs(states[:, 2])
        + weights.steep * np.maximum(0.0, steep - weights.steep_from)
    )


def _distinct(found: Branch, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the position of the first of ``rows`` in each cell, in ascending order."""
    states = found.states[rows]
    keys = np.column_stack([found.places[rows], states[:, 2], states[:, TARGETS:]]) / _CELL
    _, index = np.unique(np.round(keys).astype(np.int64), axis=0, return_index=True)
    return np.sort(index)


def _trace(levels: list[_Level], lost_time: float, costs: FloatArray, simulated: int) -> Plan:
    actions: list[int] = []
    states: list[FloatArray] = []
    node = 0
    for level in reversed(levels[1:]):
        actions.append(int(level.action[node]))
        states.append(level.states[node])
        node = int(level.parent[node])
    states.append(levels[0].states[0])
    return Plan(tuple(actions[::-1]), np.array(states[::-1]), lost_time, costs, simulated)
