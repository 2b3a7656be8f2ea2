"""The return of plans: configured reward terms, and a learned value at the horizon.

In: reward terms, a value function, and what is known of the ground and of the episode so far. Out:
the objective of a search, whose cost is the negative discounted return.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    ACTIONS,
    LAST_PITCHES,
    FloatArray,
    Outcome,
    Profile,
    Robot,
)
from flipperctl.lookahead.dynamics import RUNNING
from flipperctl.lookahead.model import (
    Branch,
    Model,
    Nodes,
    transitions,
)
from flipperctl.lookahead.search import Scores
from flipperctl.reward_sum import RewardSum


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


_SLOW = 0.3
"""Share of the way at full speed below which a plan stands [-]."""


@dataclass(frozen=True)
class Returns:
    """The objective of one decision's search."""

    rewards: RewardSum
    horizon: Callable[[Nodes], FloatArray]
    """Returns the expected discounted return from nodes on, (M,) [-]."""
    gamma: float
    """Discount per decision [-]."""
    profile: Profile
    """The known ground."""
    robot: Robot
    root: Nodes
    """The robot before its decision, one node."""
    standing: int
    """Number of decisions in which the robot has stood until now."""
    patience: int
    """Number of decisions without progress after which an episode ends as stuck [-]."""
    averaging: float = 0.0
    """Share of the estimates at smaller depths in the return of a plan, 0 to 1. The best of many
    plans is often the one whose value errs most; its errors at several depths average out."""

    @property
    def poses(self) -> bool:
        """Reward terms see the poses between decisions."""
        return True

    def begin(self, model: Model, root: FloatArray) -> ReturnAccount:
        """Return the account of a search from the state ``root``."""
        nodes, zero = replace(self.root, states=root[None]), np.zeros(1)
        return ReturnAccount(self, nodes, 0, zero, zero)


@dataclass(frozen=True)
class ReturnAccount:
    """The discounted reward of the plans of M nodes."""

    objective: Returns
    nodes: Nodes
    depth: int
    """Number of decisions from the root."""
    earned: FloatArray
    """Discounted rewards from the root, (M,) [-]."""
    estimate: FloatArray
    """Estimated return of the plans, (M,) [-]."""

    def take(self, rows: NDArray[np.int64]) -> ReturnAccount:
        """Return the account of some of the nodes."""
        return replace(
            self,
            nodes=self.nodes.take(rows),
            earned=self.earned[rows],
            estimate=self.estimate[rows],
        )

    def extend(self, parent: NDArray[np.int64], action: NDArray[np.int64], found: Branch) -> Scores:
        """Return the scores of plans that are one decision longer."""
        o, period = self.objective, self.objective.robot.decision_period
        before = self.nodes.take(parent)
        after = before.after(found, action, period)
        ts = transitions(before, after, found, o.profile, o.robot)
        reward = o.rewards.array(ts)
        ended = found.outcome != RUNNING
        ahead = np.zeros(len(parent))
        going = np.flatnonzero(~ended)
        ahead[going] = o.horizon(after.take(going))
        distance = found.places[:, 0] - o.root.places[0, 0]
        way = o.robot.track_speed * period * (self.depth + 1)
        if o.standing:
            # The longer the robot has stood, the likelier the episode ends before it moves. The
            # value does not know how long it has stood.
            rows = np.flatnonzero(~ended & (distance < _SLOW * way))
            risk = min(1.0, (o.standing + self.depth + 1) / o.patience)
            if len(rows):
                stuck = o.rewards.array(ts.ending(rows, Outcome.STUCK))
                reward[rows] += risk * (stuck - reward[rows])
                ahead[rows] *= 1.0 - risk
        discount = o.gamma**self.depth
        earned = self.earned[parent] + discount * reward
        estimate = earned + discount * o.gamma * ahead
        if self.depth and o.averaging:
            mixed = o.averaging * self.estimate[parent] + (1 - o.averaging) * estimate
            estimate = np.where(ended, estimate, mixed)
        return Scores(
            cost=-estimate,
            hurried=-distance,
            ended=ended,
            lost_time=np.maximum(0.0, period * (self.depth + 1) - distance / o.robot.track_speed),
            account=ReturnAccount(o, after, self.depth + 1, earned, estimate),
        )
