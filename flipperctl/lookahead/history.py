"""What a policy remembers of its own episode, for reward terms that look back."""

from __future__ import annotations

import numpy as np

from flipperctl.api import ACTIONS, LAST_PITCHES, FloatArray
from flipperctl.lookahead.nodes import Nodes


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
