"""Predicted robots as rows of arrays, and the decisions between them as ``Transitions``.

In: states of the prediction model, and the branches between them. Out: what reward terms see.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    ACTIONS,
    LAST_PITCHES,
    FloatArray,
    Outcome,
    Profile,
    RobotGeometry,
    RobotStates,
    Transitions,
)
from flipperctl.lookahead.layout import OVERTURNED, REACHED
from flipperctl.lookahead.model import FLIPPERS, Branch

TURNS = np.array(ACTIONS)
"""Turns (front, rear) of each action, (9, 2)."""
_OUTCOMES = np.array([None, None, None], dtype=object)
_OUTCOMES[OVERTURNED], _OUTCOMES[REACHED] = Outcome.OVERTURNED, Outcome.REACHED


@dataclass(frozen=True, kw_only=True)
class Nodes:
    """M predicted robots, each before its next decision."""

    states: FloatArray
    """States of the prediction model, (M, ``STATE``)."""
    places: FloatArray
    """x and z of the chassis centre, (M, 2) [m]."""
    pitches: FloatArray
    """Pitch at the last decisions and now, (M, T) [rad]; at most ``LAST_PITCHES``."""
    turns: NDArray[np.int64]
    """Turns (front, rear) of the last decision, (M, 2); 0 before the first."""
    time: FloatArray
    """Time since the start of the episode, (M,) [s]."""

    def __len__(self) -> int:
        return len(self.states)

    def take(self, rows: NDArray[np.int64]) -> Nodes:
        """Return some of the nodes."""
        return Nodes(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    @classmethod
    def at_rest(cls, states: FloatArray, places: FloatArray) -> Nodes:
        """Return robots that have stood with their present pitch.

        An episode knows no pitch before its start; all nodes of a graph have equally many.
        """
        count = len(states)
        return cls(
            states=states,
            places=places,
            pitches=np.repeat(states[:, 2:3], LAST_PITCHES, axis=1),
            turns=np.zeros((count, 2), np.int64),
            time=np.zeros(count),
        )

    @classmethod
    def joined(cls, parts: Sequence[Nodes]) -> Nodes:
        """Return the nodes of several parts."""
        names = [f.name for f in fields(cls)]
        return cls(**{n: np.concatenate([getattr(part, n) for part in parts]) for n in names})

    def moved_to(self, others: Nodes, rows: NDArray[np.int64]) -> Nodes:
        """Return the nodes with the states of ``others`` in some ``rows``, with their own past."""
        states, places, pitches = self.states.copy(), self.places.copy(), self.pitches.copy()
        states[rows], places[rows] = others.states, others.places
        pitches[rows, -1] = others.states[:, 2]
        return replace(self, states=states, places=places, pitches=pitches)

    def after(self, branch: Branch, action: NDArray[np.int64], period: float) -> Nodes:
        """Return the nodes to which a decision of ``period`` [s] leads from each node.

        ``branch`` and ``action`` (M,) belong to these nodes, row by row.
        """
        pitches = np.column_stack([self.pitches, branch.states[:, 2]])[:, -LAST_PITCHES:]
        return Nodes(
            states=branch.states,
            places=branch.places,
            pitches=pitches,
            turns=TURNS[action],
            time=self.time + period,
        )

    def robots(self) -> RobotStates:
        """Return the nodes as the states that reward terms see."""
        states, places = self.states, self.places
        offset = states[:, :2] - places  # from the chassis centre to the centre of mass [m]
        turn = states[:, 5]
        velocity = np.column_stack(
            [states[:, 3] + turn * offset[:, 1], states[:, 4] - turn * offset[:, 0]]
        )
        return RobotStates(
            position=places,
            pitch=states[:, 2],
            front=states[:, FLIPPERS],
            rear=states[:, FLIPPERS + 1],
            velocity=velocity,
            pitch_rate=turn,
            time=self.time,
        )


def transitions(
    before: Nodes, after: Nodes, branch: Branch, profile: Profile, robot: RobotGeometry
) -> Transitions:
    """Return the decisions that led from ``before`` to ``after``, row by row.

    ``branch`` has the poses in between.
    """
    return Transitions(
        before=before.robots(),
        after=after.robots(),
        pitches=after.pitches,
        action=after.turns,
        previous_action=before.turns,
        path=branch.poses[:, :, :3],
        flippers=branch.poses[:, :, 3:],
        profile=profile,
        robot=robot,
        outcome=_OUTCOMES[branch.outcome].tolist(),
    )
