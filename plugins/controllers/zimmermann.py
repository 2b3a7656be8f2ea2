"""``zimmermann``: Q-learning over five postures of the flippers."""

import math
from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import (
    Controller,
    FloatArray,
    Perception,
    Simulator,
    TrainingEpisodes,
    controller,
)

from .ground import Ground, Rows, ground, table
from .rules import towards

POSTURES = (
    (0.0, 0.0),
    (math.pi / 3, math.pi / 3),
    (0.7, 0.0),
    (-0.35, -0.35),
    (-0.9, -0.9),
)
"""I, V, L, U soft and U hard: angles of the front and the rear pair [rad].

The first one is taken in a cell without experience.
"""
CELLS = 36
_STEEP, _EDGES, _DROP = 0.15, (0.05, 0.18), -0.08
"""Ends of the cells: of the pitch, both ways [rad]; of heights [m]."""
_HOLD = 6
"""Decisions after which a posture is chosen anew within a cell, while it learns [-]."""
_LEAST = 0.05
"""Share of random postures at the end of the learning [-]."""


def cell(seen: Ground, pitch: float) -> int:
    """Return the number of the cell, 0 to 35, in which the robot is.

    Cells differ by the pitch (three ranges), the highest and the lowest ground ahead (three and
    two), and the lowest below the rear half (two).
    """
    steep = int(pitch > -_STEEP) + int(pitch > _STEEP)
    high = sum(seen.highest > edge for edge in _EDGES)
    return ((steep * 3 + high) * 2 + int(seen.lowest < _DROP)) * 2 + int(seen.rear_lowest < _DROP)


class Visit(NamedTuple):
    """A posture that was kept in a cell for some decisions."""

    cell: int
    posture: int
    first: int
    """Its first decision."""


def q_update(
    q: FloatArray,
    counts: FloatArray,
    visits: Sequence[Visit],
    rewards: FloatArray,
    discount: float,
    trace: float,
) -> None:
    """Update the Q-values (C, K) by an episode, backward; ``counts`` (C, K) are earlier updates.

    The target of a visit is its discounted rewards and, after them, the best Q-value of the next
    cell. A ``trace`` of it is the next visit's own target instead, where its posture is the best
    one (Watkins' Q(λ)). The step is 1 / n^0.8 at the n-th update.
    """
    after, end = 0.0, len(rewards)
    # Backwards, so that the next visit's target is known
    for number in reversed(range(len(visits))):
        at, posture, first = visits[number]
        if number + 1 < len(visits):
            following = visits[number + 1]
            best = int(q[following.cell].argmax())
            value = q[following.cell, best]
            if best == following.posture:
                value = (1 - trace) * value + trace * after
        else:
            value = 0.0
        count = end - first  # decisions of the visit
        after = float(rewards[first:end] @ discount ** np.arange(count) + discount**count * value)
        # Later updates weigh less, so that the values settle.
        counts[at, posture] += 1
        q[at, posture] += (after - q[at, posture]) / counts[at, posture] ** 0.8
        end = first


def tried(q: FloatArray, counts: FloatArray) -> FloatArray:
    """Return the Q-values (C, K), where a posture never tried in its cell has the cell's least."""
    return np.where(counts > 0, q, q.min(axis=1, keepdims=True))


@controller("zimmermann")
class Zimmermann(Controller):
    """Take one of five postures, by Q-values of 36 cells of pitch and perceived ground.

    Zimmermann et al. (ICRA 2014) learn by Q-learning which of five configurations of the flippers
    suits the terrain. The postures come from the group's later work. Both pairs are level in I and
    up in V. L has the front pair up. U soft and U hard have both down, half and fully.
    """

    q: Rows = Field(
        (),
        description="Q-value of each posture in each cell, 36 rows of 5; empty: those of the "
        "package, learnt on the ten families [-]",
    )
    discount: float = Field(0.9, ge=0, le=1, description="discount of a decision in learning [-]")
    trace: float = Field(
        0.8, ge=0, le=1, description="λ, share of observed returns in the targets of learning [-]"
    )
    exploration: float = Field(
        0.5, ge=0, le=1, description="share of random postures when learning begins [-]"
    )

    @model_validator(mode="after")
    def _q_is_whole(self) -> Self:
        if self.q and [len(row) for row in self.q] != [len(POSTURES)] * CELLS:
            raise ValueError(f"q needs {CELLS} rows of {len(POSTURES)} numbers")
        return self

    def act(self, p: Perception) -> int:
        """Turn each pair one step towards the best posture of the cell."""
        row = (self.q or SHIPPED)[cell(ground(p.observation, p.layout, p.robot), p.pitch)]
        return towards(p, *map(p.robot.clip, POSTURES[row.index(max(row))]))

    def learn(self, episodes: TrainingEpisodes) -> Self:
        """Return the rule with Q-values of Watkins' Q(λ), from zeros on."""
        q, counts = np.zeros((CELLS, len(POSTURES))), np.zeros((CELLS, len(POSTURES)))
        total = max(1, episodes.left)
        while episodes.left:
            share = episodes.left / total
            # The share of random postures falls to the least after three quarters.
            explore = max(_LEAST, self.exploration * (4 * share - 1) / 3)
            policy = _Exploring(q, explore, episodes.rng)
            rewards = episodes.play(policy).rewards
            q_update(q, counts, policy.visits, rewards, self.discount, self.trace)
        return self.model_copy(update={"q": table(tried(q, counts).tolist(), 3)})


class _Exploring:
    """Keeps a posture while the robot is in a cell: the best one, or a random one."""

    def __init__(self, q: FloatArray, explore: float, rng: np.random.Generator) -> None:
        self._q, self._explore, self._rng = q, explore, rng
        self.visits: list[Visit] = []
        self._decision = 0

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode."""
        self.visits, self._decision = [], 0

    def act(self, p: Perception) -> int:
        """Turn each pair one step towards the posture."""
        at, now = cell(ground(p.observation, p.layout, p.robot), p.pitch), self._decision
        last = self.visits[-1] if self.visits else None
        # A posture lasts while the robot stays in the cell, but not for long.
        if last is None or last.cell != at or now - last.first >= _HOLD:
            posture = int(self._q[at].argmax())
            if self._rng.random() < self._explore:
                posture = int(self._rng.integers(len(POSTURES)))
            self.visits.append(Visit(at, posture, now))
        self._decision += 1
        return towards(p, *map(p.robot.clip, POSTURES[self.visits[-1].posture]))


SHIPPED: Rows = (
    (-0.312, -0.328, -0.269, -0.349, -0.383),
    (-0.564, -0.634, -0.597, -0.557, -0.581),
    (-0.391, -0.414, -0.347, -0.475, -0.47),
    (-0.419, -0.524, -0.456, -0.499, -0.51),
    (-0.679, -0.613, -0.679, -0.621, -0.654),
    (-0.743, -0.734, -0.747, -0.73, -0.732),
    (-0.659, -0.612, -0.692, -0.874, -0.605),
    (-0.784, -0.732, -0.98, -0.75, -0.806),
    (-0.693, -0.693, -0.693, -0.693, -0.693),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (-0.816, -0.834, -0.834, -0.834, -0.834),
    (-0.239, -0.224, -0.22, -0.296, -0.308),
    (-0.448, -0.541, -0.461, -0.465, -0.491),
    (-0.423, -0.575, -0.529, -0.476, -0.56),
    (-0.572, -0.676, -0.601, -0.594, -0.581),
    (-0.57, -0.564, -0.541, -0.597, -0.549),
    (-0.679, -0.668, -0.65, -0.668, -0.596),
    (-0.477, -0.495, -0.502, -0.556, -0.482),
    (-0.733, -0.771, -0.644, -0.765, -0.637),
    (-0.676, -0.69, -0.637, -0.626, -0.627),
    (-0.678, -0.666, -0.653, -0.655, -0.597),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (-0.79, -0.695, -0.692, -0.734, -0.658),
    (-0.476, -0.435, -0.352, -0.419, -0.458),
    (-0.745, -1.05, -0.713, -0.652, -0.642),
    (-0.667, -0.73, -0.899, -0.868, -0.574),
    (-0.912, -1.683, -1.106, -0.873, -0.78),
    (-0.451, -0.679, -0.546, -0.583, -0.571),
    (-0.604, -0.884, -0.633, -0.656, -0.649),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (-0.775, -1.09, -0.811, -0.734, -0.73),
    (-0.67, -0.673, -0.664, -0.667, -0.669),
    (-0.617, -2.048, -0.541, -0.689, -0.618),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (-0.755, -0.893, -0.764, -0.761, -0.752),
)
