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
        kept = end - first
        after = float(rewards[first:end] @ discount ** np.arange(kept) + discount**kept * value)
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
    suits the terrain. The postures are those of the group's later work: I with both pairs level, V
    with both up, L with the front pair up, and U with both down, half and fully.
    """

    q: Rows = Field(
        (),
        description="Q-value of each posture in each cell, 36 rows of 5; empty: those of the "
        "package, learnt on the ten families [-]",
    )
    discount: float = Field(0.97, ge=0, le=1, description="discount of a decision in learning [-]")
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
            share = (
                episodes.left / total
            )  # of random postures: falls to the least at three quarters
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
        if last is None or last.cell != at or now - last.first >= _HOLD:
            posture = int(self._q[at].argmax())
            if self._rng.random() < self._explore:
                posture = int(self._rng.integers(len(POSTURES)))
            self.visits.append(Visit(at, posture, now))
        self._decision += 1
        return towards(p, *map(p.robot.clip, POSTURES[self.visits[-1].posture]))


SHIPPED: Rows = (
    (-0.687, -0.799, -0.813, -0.884, -0.889),
    (-0.752, -0.78, -0.699, -0.865, -0.855),
    (-1.116, -1.075, -0.934, -1.042, -1.052),
    (-0.595, -0.559, -0.485, -0.583, -0.664),
    (-1.237, -1.23, -1.244, -1.348, -1.221),
    (-1.216, -1.134, -1.25, -1.269, -1.047),
    (-1.179, -1.246, -1.119, -1.163, -1.147),
    (-1.069, -1.162, -1.091, -1.057, -1.108),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (-1.062, -1.169, -1.177, -1.081, -1.111),
    (-0.855, -1.062, -1.008, -0.972, -1.033),
    (-0.787, -0.97, -0.932, -0.965, -0.947),
    (-0.568, -0.573, -0.547, -0.644, -0.623),
    (-1.353, -1.327, -1.33, -1.327, -1.298),
    (-1.068, -1.056, -1.091, -1.015, -1.217),
    (-1.256, -1.327, -1.248, -1.231, -1.155),
    (-1.159, -1.221, -1.2, -1.212, -1.198),
    (-1.45, -1.391, -1.379, -1.424, -1.375),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (-1.349, -1.306, -1.277, -1.376, -1.23),
    (-1.317, -1.391, -1.312, -1.306, -1.302),
    (-1.54, -2.305, -1.721, -1.486, -1.44),
    (-1.199, -1.466, -1.213, -1.162, -1.262),
    (-1.159, -1.291, -1.122, -1.014, -1.097),
    (-0.621, -0.829, -0.912, -0.856, -0.907),
    (-1.501, -1.932, -1.473, -1.454, -1.399),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (-1.201, -1.366, -1.089, -1.204, -1.188),
    (-0.825, -1.18, -1.178, -1.186, -1.187),
    (-1.518, -1.87, -1.54, -1.526, -1.515),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (-1.211, -3.853, -1.025, -1.253, -1.294),
    (-1.293, -1.297, -1.295, -1.283, -1.275),
)
