"""Records episodes for a file while they are played.

In: decisions of one episode with their labels. Out: a ``RecordedEpisode``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import ACTIONS, Outcome
from flipperctl.checkpoint.recording import RecordedEpisode
from flipperctl.rollout.episode import Row

NO_LABEL = np.zeros(len(ACTIONS), np.float32)


class EpisodeRecorder:
    """Collects the decisions of one episode at a time."""

    def __init__(self) -> None:
        self._observations: list[NDArray[np.float32]] = []
        self._decisions: list[tuple[int, float, NDArray[np.float32]]] = []

    def add(
        self,
        observation: NDArray[np.float32],
        action: int,
        reward: float,
        next_observation: NDArray[np.float32],
        label: NDArray[np.float32] | None,
    ) -> None:
        """Add a decision; the observations are of single instants, (N + 3,) in SI units."""
        if not self._decisions:
            self._observations.append(observation)
        self._observations.append(next_observation)
        self._decisions.append((action, reward, NO_LABEL if label is None else label))

    def drop(self) -> None:
        """Discard the running episode."""
        self._observations, self._decisions = [], []

    def finish(self, number: int, ending: Row) -> RecordedEpisode:
        """Return the episode that the last decision ended; begin the next one.

        ``number`` counts episodes from 0; ``ending`` has the seed, outcome and terrain.
        """
        actions, rewards, labels = zip(*self._decisions, strict=True)
        found = RecordedEpisode(
            number=number,
            seed=ending["seed"],
            terrain=ending["terrain"],
            outcome=Outcome(ending["outcome"]),
            observations=np.array(self._observations, np.float32),
            actions=np.array(actions, np.int64),
            rewards=np.array(rewards, np.float64),
            labels=np.array(labels, np.float32),
        )
        self.drop()
        return found
