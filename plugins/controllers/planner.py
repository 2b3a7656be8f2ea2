"""A search over flipper commands in the simulator: what a scene allows, without any training."""

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
_TRIES = 20
"""Plans of a search that are tried in the episode's own world."""
_STRAYED = 0.02
"""A plan has strayed where the episode's own world differs by more from the search [m]."""


@dataclass(frozen=True)
class _Moment:
    """A state that the search came to."""

    state: RobotState
    cost: float
    """Until here and, at full speed, from here to the finish [s]."""
    variation: float
    """θ̂_R so far [rad]."""
    saved: Any
    parent: _Moment | None = None
    action: int = _HOLD
    """What led here from ``parent``."""

    def path(self) -> list[_Moment]:
        """The moments from the start to here, without the start."""
        found: list[_Moment] = []
        moment = self
        while moment.parent is not None:
            found.append(moment)
            moment = moment.parent
        return found[::-1]


class _Tried(NamedTuple):
    """A plan in the episode's own world."""

    actions: list[int]
    """As far as the episode went."""
    reached: bool
    cost: float
    """[s]"""
    same: int
    """Decisions until it strayed from the search."""


@controller("planner")
class Planner(Controller):
    """Beam search through the simulated scene, before the episode begins; then it plays the plan.

    A plan costs its time and ``smoothness`` seconds for each radian of θ̂_R. The search sees the
    true scene, draws nothing at random and needs no training: a yardstick for policies, not
    something to run on a robot.
    """

    searches_first: ClassVar[bool] = True
    width: int = Field(
        40, ge=1, le=10_000, description="moments of one stretch of the way that go on [-]"
    )
    smoothness: float = Field(
        10.0, ge=0, le=1000, description="time that a radian of pitch variation is worth [s/rad]"
    )
    budget: int = Field(
        100_000, ge=1, le=100_000_000, description="decisions simulated at the most [-]"
    )
    stretch: float = Field(
        0.12, gt=0.001, le=1, description="length of the way in which moments compete [m]"
    )
    cell: float = Field(
        0.02,
        gt=0.0001,
        le=1,
        description="of moments closer than this in place and pitch, with equal flippers, one is "
        "kept [m, rad]",
    )

    def build(self) -> Policy:
        """A planner without a plan; each episode begins with a search."""
        return Plan(self)


class Plan:
    """Plans at the start of an episode, then plays the plan."""

    def __init__(self, settings: Planner) -> None:
        self._settings = settings
        self._actions: list[int] = []

    def reset(self, simulator: Simulator) -> None:
        """Search, and try the plans in the episode's own world; search again where they stray."""
        left, width, prefix = self._settings.budget, self._settings.width, list[int]()
        while True:
            found, spent = self._search(simulator, prefix, width, left)
            left -= spent
            tried = [self._followed(simulator, moment) for moment in found]
            reached = [t for t in tried if t.reached]
            best = min(reached or tried, key=lambda t: t.cost if reached else -t.same)
            if reached or left <= 0:
                self._actions = best.actions[::-1]
                return
            if best.same > len(prefix) + 1:
                prefix = best.actions[: best.same - 1]
            else:  # nothing leads on from here: further back, and wider
                prefix, width = prefix[: -len(prefix) // 4], 2 * width

    def act(self, p: Perception) -> int:
        """The next action of the plan; behind it, the flippers are held."""
        return self._actions.pop() if self._actions else _HOLD

    def _search(
        self, simulator: Simulator, prefix: list[int], width: int, budget: int
    ) -> tuple[list[_Moment], int]:
        """Moments at the finish, the cheapest first, and how many decisions it took to find them.

        Without any, the one that came farthest. Every plan begins with ``prefix``.

        Moments compete with those that are as far along the way, not with those of equal age:
        else the ones that wait before an obstacle would push out those that take it.
        """
        simulator.restart()
        start = _Moment(simulator.state, 0.0, 0.0, simulator.save())
        origin = float(start.state.position[0])
        for action in prefix:
            simulator.step(action)
            start = self._next(start, action, simulator)
        stages = {self._stage(start, origin): {self._key(start.state): start}}
        done: list[_Moment] = []
        farthest, spent = start, 0
        while stages and spent < budget:
            stage = min(stages)
            moments = sorted(stages.pop(stage).values(), key=_cost)[:width]
            if done and moments[0].cost >= min(map(_cost, done)):
                continue  # none of them can be cheaper any more
            for parent, action in self._tries(moments, simulator):
                outcome = simulator.step(action)
                spent += 1
                child = self._next(parent, action, simulator)
                if outcome is Outcome.REACHED:
                    done.append(child)
                elif outcome is None:
                    farthest = max(farthest, child, key=lambda m: float(m.state.position[0]))
                    place = max(stage + 1, self._stage(child, origin))
                    others, key = stages.setdefault(place, {}), self._key(child.state)
                    if key not in others or child.cost < others[key].cost:
                        others[key] = child
            gone = float(farthest.state.position[0]) - origin
            simulator.report_progress(min(1.0, gone / max(1e-6, simulator.finish - origin)))
        return sorted(done, key=_cost)[:_TRIES] or [farthest], spent

    def _followed(self, simulator: Simulator, goal: _Moment) -> _Tried:
        """What becomes of a plan in the episode's own world."""
        simulator.restart()
        here = _Moment(simulator.state, 0.0, 0.0, None)
        actions: list[int] = []
        same = 0
        for moment in goal.path():
            outcome = simulator.step(moment.action)
            here = self._next(here, moment.action, simulator)
            actions.append(moment.action)
            apart = np.subtract(here.state.position, moment.state.position)
            if same == len(actions) - 1 and float(np.abs(apart).max()) < _STRAYED:
                same += 1
            if outcome is not None:
                return _Tried(actions, outcome is Outcome.REACHED, here.cost, same)
        return _Tried(actions, False, here.cost, same)

    def _tries(self, moments: list[_Moment], simulator: Simulator) -> Iterator[tuple[_Moment, int]]:
        """Every action at every moment, the simulator being there."""
        limit = simulator.robot.angle_limit - 0.02
        for moment in moments:
            angles = (moment.state.front, moment.state.rear)
            for action, turns in enumerate(ACTIONS):
                # To turn against a stop is to hold.
                if all(t * a < limit for t, a in zip(turns, angles, strict=True)):
                    simulator.load(moment.saved)
                    yield moment, action

    def _next(self, parent: _Moment, action: int, simulator: Simulator) -> _Moment:
        state = simulator.state
        variation = parent.variation + abs(state.pitch - parent.state.pitch)
        left = max(0.0, simulator.finish - float(state.position[0])) / simulator.speed
        cost = state.time + left + self._settings.smoothness * variation
        return _Moment(state, cost, variation, simulator.save(), parent, action)

    def _stage(self, moment: _Moment, origin: float) -> int:
        return int((float(moment.state.position[0]) - origin) / self._settings.stretch)

    def _key(self, state: RobotState) -> tuple[int, ...]:
        x, z = state.position.tolist()
        place = (
            x / self._settings.cell,
            z / self._settings.cell,
            state.pitch / self._settings.cell,
        )
        return tuple(map(round, (*place, 10 * state.front, 10 * state.rear)))


def _cost(moment: _Moment) -> float:
    return moment.cost
