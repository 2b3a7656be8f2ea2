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
    (-0.545, -0.564, -0.563, -0.573, -0.655),
    (-0.955, -0.932, -0.96, -0.928, -1.047),
    (-0.72, -0.738, -0.696, -0.779, -0.799),
    (-0.683, -0.801, -0.801, -0.832, -0.869),
    (-0.857, -0.909, -0.954, -0.848, -0.838),
    (-0.989, -1.001, -1.095, -1.045, -1.253),
    (-0.237, -1.189, -1.189, -1.189, -1.189),
    (-1.069, -1.078, -1.053, -1.112, -1.255),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (-0.567, -0.537, -0.534, -0.589, -0.591),
    (-0.917, -0.958, -0.894, -0.945, -0.918),
    (-0.852, -1.047, -0.963, -0.908, -0.92),
    (-1.01, -1.059, -1.064, -1.026, -1.013),
    (-1.136, -1.136, -1.136, -1.137, -1.136),
    (-1.173, -1.16, -1.166, -1.166, -1.158),
    (-0.79, -0.996, -1.058, -1.093, -0.956),
    (-1.318, -1.307, -1.307, -1.323, -1.251),
    (-1.257, -1.255, -1.252, -1.252, -1.252),
    (-1.249, -1.252, -1.265, -1.24, -1.23),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (-1.343, -1.319, -1.328, -1.337, -1.317),
    (-1.083, -0.868, -0.952, -0.898, -0.941),
    (-1.029, -1.432, -1.195, -1.114, -1.071),
    (-1.389, -1.368, -1.095, -1.153, -1.196),
    (-1.447, -2.305, -1.58, -1.366, -1.339),
    (-1.109, -1.158, -1.113, -1.076, -1.1),
    (-1.16, -1.422, -1.213, -1.237, -1.226),
    (-1.204, -1.095, -1.204, -1.204, -1.204),
    (-1.409, -2.121, -1.399, -1.392, -1.387),
    (-1.212, -1.221, -1.218, -1.214, -1.21),
    (-1.107, -3.111, -1.174, -1.222, -1.172),
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (-1.393, -1.394, -1.382, -1.432, -1.366),
)
