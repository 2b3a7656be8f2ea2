"""A beam search on the true ground, to the finish or over a requested distance.

In: a state of the prediction model. Out: the cheapest sequence of actions. Nodes compete within a
distance bin, not within a depth; otherwise nodes that wait in front of an obstacle would displace
those that climb it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Robot
from flipperctl.lookahead.model import FLIPPERS, Model
from flipperctl.lookahead.search import HOLD, moves, target_cell
from flipperctl.lookahead.settings import STEEP, STEEP_FROM

_ROUNDS = 8
"""Largest number of decisions of a node in one distance bin."""


@dataclass(frozen=True)
class Goal:
    """Where a search ends, and the cost weights of its plans."""

    finish: float
    """World x that the chassis centre must pass [m]."""
    top: float
    """Largest world z of the chassis' ends at the finish [m]."""
    smoothness: float
    """Cost weight of the pitch variation at 100 Hz [s/rad]."""
    distance: float = math.inf
    """Distance after which a search ends short of the finish [m]."""
    pitch: float = 0.0
    """Cost weight of the absolute pitch after that distance [s/rad]."""


class SearchResult(NamedTuple):
    """The result of a search, or of a simulated plan."""

    actions: tuple[int, ...]
    cost: float
    """Cost from the root: time, remaining time at full speed, weighted pitch variation [s]."""
    distance: float
    """Distance from the root [m]."""
    complete: bool
    """Whether the plan reaches the finish or the requested distance."""


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
    width: int
    """Nodes that are expanded in each distance bin."""
    bin_length: float
    """Length of a distance bin [m]."""
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
        place = np.array([self.model.chassis(root)])
        zero = np.zeros(1)
        begin = float(place[0, 0])
        last = min(self.goal.finish, begin + self.goal.distance)
        none = np.array([-1])
        start = _Nodes(root[None], place, zero, zero, zero, zero, none, none)
        bins: dict[int, list[_Nodes]] = {0: [start]}
        expanded: list[_Nodes] = []
        count, best, final, farthest = 0, bound, (-1, -1), (begin, -1, -1)
        limit = self.spent + budget
        while bins and self.spent < limit:
            index = min(bins)
            fresh = bins.pop(index)
            seen = np.zeros(0)
            for _ in range(_ROUNDS):
                nodes = self._beam(_Nodes.joined(fresh), seen, best)
                if not len(nodes.cost) or self.spent >= limit:
                    break
                seen = np.concatenate([seen, nodes.cost])
                expanded.append(nodes)
                children = self._children(nodes, count)
                count += len(nodes.cost)
                ended = self._ended(children, last)
                if ended.any():
                    row = np.flatnonzero(ended)[np.argmin(children.cost[ended])]
                    if children.cost[row] < best:
                        best = float(children.cost[row])
                        final = int(children.parent[row]), int(children.action[row])
                children = children.take(~ended)
                if not len(children.cost):
                    break
                row = int(np.argmax(children.places[:, 0]))
                if children.places[row, 0] > farthest[0]:
                    farthest = (
                        float(children.places[row, 0]),
                        *(int(children.parent[row]), int(children.action[row])),
                    )
                at = ((children.places[:, 0] - begin) / self.bin_length).astype(np.int64)
                at = np.maximum(at, index)
                for found in np.unique(at[at > index]).tolist():
                    bins.setdefault(found, []).append(children.take(at == found))
                fresh = [children.take(at == index)]
                if not len(fresh[0].cost):
                    break
        complete = final[0] >= 0
        tail = final if complete else farthest[1:]
        actions = _trace(expanded, *tail)
        distance = (last if complete else farthest[0]) - begin
        return SearchResult(actions, best if complete else math.inf, distance, complete)

    def follow(self, root: FloatArray, actions: tuple[int, ...]) -> SearchResult:
        """Simulate a plan from the state ``root``, with the same costs as in ``search``."""
        place = np.array([self.model.chassis(root)])
        zero, none = np.zeros(1), np.array([-1])
        begin = float(place[0, 0])
        last = min(self.goal.finish, begin + self.goal.distance)
        nodes = _Nodes(root[None], place, zero, zero, zero, zero, none, none)
        for done, action in enumerate(actions):
            children = self._children(nodes, 0, action)
            if not len(children.cost):
                distance = float(nodes.places[0, 0]) - begin
                return SearchResult(actions[:done], math.inf, distance, False)
            nodes = children
            if self._ended(nodes, last)[0]:
                distance = float(nodes.places[0, 0]) - begin
                return SearchResult(actions[: done + 1], float(nodes.cost[0]), distance, True)
        return SearchResult(actions, math.inf, float(nodes.places[0, 0]) - begin, False)

    def _beam(self, nodes: _Nodes, seen: FloatArray, best: float) -> _Nodes:
        """Return the nodes to expand, cheapest first.

        ``seen``: costs of the nodes that were expanded in this bin before [s].
        """
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
        rank = np.searchsorted(np.sort(seen), nodes.cost) + np.arange(len(nodes.cost))
        return nodes.take(rank < self.width)

    def _children(self, nodes: _Nodes, first: int, action: int | None = None) -> _Nodes:
        """Return the nodes one decision later that have not overturned."""
        parent, taken, targets = moves(nodes.states, self.robot)
        if action is not None:
            chosen = taken == action
            if not chosen.any():  # turning a flipper against its stop
                chosen = taken == HOLD
            parent, taken, targets = parent[chosen], taken[chosen], targets[chosen]
        period, speed = self.robot.decision_period, self.robot.track_speed
        found = self.model.expand(nodes.states[parent], targets, period)
        self.spent += len(parent)
        time = nodes.time[parent] + period
        variation = nodes.variation[parent] + found.pitch_variation
        steep = np.maximum(nodes.steep[parent], found.steepest)
        left = (self.goal.finish - found.places[:, 0]) / speed  # negative past the finish
        cost = time + left + self.goal.smoothness * variation
        cost += STEEP * np.maximum(0.0, steep - STEEP_FROM)
        children = _Nodes(
            found.states, found.places, time, variation, steep, cost, first + parent, taken
        )
        return children.take(found.steepest < self.model.overturn)

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
