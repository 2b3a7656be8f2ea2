"""A beam search over flipper commands in the simulator: what a scene allows without training."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from flipperctl.api import (
    ACTIONS,
    Controller,
    Outcome,
    Perception,
    Policy,
    RobotState,
    Simulator,
    action_index,
    controller,
)

_HOLD = action_index(0, 0)
_MAX_REPLAYS = 20
"""Largest number of plans of one search that are replayed in the episode's own world."""
_DIVERGENCE = 0.02
"""Position error above which a replay has diverged from the search [m]."""


@dataclass(frozen=True)
class SearchNode:
    """A state that the search has reached, and the action that led to it."""

    state: RobotState
    cost: float
    """Cost of the plan to this node plus the time to the finish at full speed [s]."""
    variation: float
    """Pitch variation θ̂_R from the start to this node [rad]."""
    snapshot: Any
    """Snapshot of the simulator at this node; None where it is not needed."""
    parent: SearchNode | None = None
    action: int = _HOLD
    """Action that led from ``parent`` to this node."""

    def path(self) -> list[SearchNode]:
        """Return the nodes from the start to this one, without the start."""
        found: list[SearchNode] = []
        node = self
        while node.parent is not None:
            found.append(node)
            node = node.parent
        return found[::-1]


class _Replay(NamedTuple):
    """Result of replaying a plan in the episode's own world."""

    actions: list[int]
    """Actions of the plan until the episode ended."""
    reached: bool
    """Whether the replay reached the finish."""
    cost: float
    """Cost of the replay, as of a node [s]."""
    matching: int
    """Number of decisions before the replay diverged from the search [-]."""


@controller("planner")
class Planner(Controller):
    """Beam search through the simulated scene before the episode begins; then the plan is played.

    A plan costs its time plus ``smoothness`` seconds for each radian of θ̂_R. The search knows the
    true scene, is deterministic and needs no training. It is a yardstick for policies and cannot
    run on a robot.
    """

    searches_first: ClassVar[bool] = True
    width: int = Field(
        40, ge=1, le=10_000, description="beam width: nodes expanded in each distance bin [-]"
    )
    smoothness: float = Field(
        10.0, ge=0, le=1000, description="time that a radian of pitch variation is worth [s/rad]"
    )
    budget: int = Field(
        100_000, ge=1, le=100_000_000, description="largest number of simulated decisions [-]"
    )
    stretch: float = Field(
        0.12, gt=0.001, le=1, description="length of a distance bin, in which nodes compete [m]"
    )
    cell: float = Field(
        0.02,
        gt=0.0001,
        le=1,
        description="nodes closer than this in position and pitch, with equal flipper angles, are "
        "merged into the cheapest [m, rad]",
    )

    def build(self) -> Policy:
        """Return a policy that searches for a plan at the start of each episode."""
        return PlannerPolicy(self)


class PlannerPolicy:
    """Search for a plan at the start of an episode, then play it."""

    def __init__(self, settings: Planner) -> None:
        self._settings = settings
        self._actions: list[int] = []

    def reset(self, simulator: Simulator) -> None:
        """Search, replay the plans in the episode's own world, and search again if they diverge."""
        left, width, prefix = self._settings.budget, self._settings.width, list[int]()
        while True:
            found, spent = self._search(simulator, prefix, width, left)
            left -= spent
            replays = [self._replay(simulator, node) for node in found]
            reached = [r for r in replays if r.reached]
            best = min(reached or replays, key=lambda r: r.cost if reached else -r.matching)
            if reached or left <= 0:
                self._actions = best.actions[::-1]
                return
            if best.matching > len(prefix) + 1:
                prefix = best.actions[: best.matching - 1]
            else:  # a dead end: shorten the prefix and widen the beam
                prefix, width = prefix[: -len(prefix) // 4], 2 * width

    def act(self, p: Perception) -> int:
        """Return the next action of the plan, and hold the flippers after its last one."""
        return self._actions.pop() if self._actions else _HOLD

    def _search(
        self, simulator: Simulator, prefix: list[int], width: int, budget: int
    ) -> tuple[list[SearchNode], int]:
        """Return the nodes at the finish, cheapest first, and the number of simulated decisions.

        If no node is at the finish, return the one that came farthest. Every plan begins with
        ``prefix``.

        Nodes compete with those of the same distance bin, not with those of the same age.
        Otherwise nodes that wait before an obstacle would displace those that climb it.
        """
        simulator.restart()
        start = SearchNode(simulator.state, 0.0, 0.0, simulator.save())
        origin = float(start.state.position[0])
        for action in prefix:
            simulator.step(action)
            start = self._child(start, action, simulator)
        bins = {self._distance_bin(start, origin): {self._state_key(start.state): start}}
        finished: list[SearchNode] = []
        farthest, spent = start, 0
        while bins and spent < budget:
            index = min(bins)
            beam = sorted(bins.pop(index).values(), key=_cost)[:width]
            if finished and beam[0].cost >= min(map(_cost, finished)):
                continue  # no child of this beam can be cheaper than the best plan
            for parent, action in self._expand(beam, simulator):
                outcome = simulator.step(action)
                spent += 1
                child = self._child(parent, action, simulator)
                if outcome is Outcome.REACHED:
                    finished.append(child)
                elif outcome is None:
                    farthest = max(farthest, child, key=lambda n: float(n.state.position[0]))
                    later = max(index + 1, self._distance_bin(child, origin))
                    rivals, key = bins.setdefault(later, {}), self._state_key(child.state)
                    if key not in rivals or child.cost < rivals[key].cost:
                        rivals[key] = child
            gone = float(farthest.state.position[0]) - origin
            simulator.report_progress(min(1.0, gone / max(1e-6, simulator.finish - origin)))
        return sorted(finished, key=_cost)[:_MAX_REPLAYS] or [farthest], spent

    def _replay(self, simulator: Simulator, goal: SearchNode) -> _Replay:
        """Play the plan that leads to ``goal`` in the episode's own world."""
        simulator.restart()
        here = SearchNode(simulator.state, 0.0, 0.0, None)
        actions: list[int] = []
        matching = 0
        for node in goal.path():
            outcome = simulator.step(node.action)
            here = self._child(here, node.action, simulator)
            actions.append(node.action)
            error = np.subtract(here.state.position, node.state.position)
            if matching == len(actions) - 1 and float(np.abs(error).max()) < _DIVERGENCE:
                matching += 1
            if outcome is not None:
                return _Replay(actions, outcome is Outcome.REACHED, here.cost, matching)
        return _Replay(actions, False, here.cost, matching)

    def _expand(
        self, nodes: list[SearchNode], simulator: Simulator
    ) -> Iterator[tuple[SearchNode, int]]:
        """Yield every node with every useful action, with the simulator at that node."""
        limit = simulator.robot.angle_limit - 0.02
        for node in nodes:
            angles = (node.state.front, node.state.rear)
            for action, turns in enumerate(ACTIONS):
                # Turning a flipper against its stop equals holding it.
                if all(t * a < limit for t, a in zip(turns, angles, strict=True)):
                    simulator.load(node.snapshot)
                    yield node, action

    def _child(self, parent: SearchNode, action: int, simulator: Simulator) -> SearchNode:
        state = simulator.state
        variation = parent.variation + abs(state.pitch - parent.state.pitch)
        left = max(0.0, simulator.finish - float(state.position[0])) / simulator.speed
        cost = state.time + left + self._settings.smoothness * variation
        return SearchNode(state, cost, variation, simulator.save(), parent, action)

    def _distance_bin(self, node: SearchNode, origin: float) -> int:
        return int((float(node.state.position[0]) - origin) / self._settings.stretch)

    def _state_key(self, state: RobotState) -> tuple[int, ...]:
        x, z = state.position.tolist()
        pose = (
            x / self._settings.cell,
            z / self._settings.cell,
            state.pitch / self._settings.cell,
        )
        return tuple(map(round, (*pose, 10 * state.front, 10 * state.rear)))


def _cost(node: SearchNode) -> float:
    return node.cost
