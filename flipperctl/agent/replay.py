"""Uniform replay of n-step transitions in preallocated arrays.

In: decisions in the order in which they happen. Out: random batches of
(observation, action, discounted reward of n decisions, observation n later, discount there).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.memory import gigabytes
from flipperctl.errors import ConfigError


def row_bytes(size: int) -> int:
    """Memory of one transition whose observations have ``size`` numbers [B]."""
    return 2 * 4 * size + 8 + 4 + 4


@dataclass(frozen=True)
class Batch:
    """Transitions as tensors."""

    observation: torch.Tensor
    """(B, N + 3) float32, SI units."""
    action: torch.Tensor
    """(B,) int64."""
    reward: torch.Tensor
    """(B,) float32, sum of up to n discounted rewards."""
    next_observation: torch.Tensor
    """(B, N + 3) float32, up to n decisions later."""
    discount: torch.Tensor
    """(B,) float32, γⁿ or 0 where the episode ended."""

    def to(self, device: torch.device) -> Batch:
        """The batch on another device."""
        if device.type == "cpu":
            return self
        return Batch(**{name: getattr(self, name).to(device) for name in Replay.FIELDS})


class Replay:
    """A ring of ``capacity`` transitions."""

    FIELDS = ("observation", "action", "reward", "next_observation", "discount")

    def __init__(self, capacity: int, size: int, n_step: int, gamma: float) -> None:
        """``size``: length of an observation.

        Raises:
            ConfigError: the system has not as much memory to give.
        """
        self.capacity = capacity
        try:
            self.arrays: dict[str, NDArray[Any]] = {
                "observation": np.zeros((capacity, size), np.float32),
                "action": np.zeros(capacity, np.int64),
                "reward": np.zeros(capacity, np.float32),
                "next_observation": np.zeros((capacity, size), np.float32),
                "discount": np.zeros(capacity, np.float32),
            }
        except MemoryError as error:
            raise ConfigError(
                f"agent.replay_size: {capacity:,} transitions of {size} numbers each take "
                f"{gigabytes(capacity * row_bytes(size))} of memory, more than there is; keep fewer"
            ) from error
        self.added = 0
        self._gamma = gamma
        self._pending: deque[tuple[NDArray[np.float32], int, float]] = deque()
        self._n_step = n_step

    def __len__(self) -> int:
        return min(self.added, self.capacity)

    def add(
        self,
        observation: NDArray[np.float32],
        action: int,
        reward: float,
        next_observation: NDArray[np.float32],
        *,
        over: bool,
        bootstrap: bool,
    ) -> None:
        """One decision. ``over``: the episode ended; ``bootstrap``: its value goes on behind it."""
        self._pending.append((observation, action, reward))
        goes_on = 1.0 if bootstrap or not over else 0.0
        if len(self._pending) == self._n_step:
            self._flush(next_observation, goes_on)
        while over and self._pending:
            self._flush(next_observation, goes_on)

    def _flush(self, next_observation: NDArray[np.float32], goes_on: float) -> None:
        total = 0.0
        for _, _, reward in reversed(self._pending):
            total = reward + self._gamma * total
        length = len(self._pending)
        observation, action, _ = self._pending.popleft()
        row = self.added % self.capacity
        values = (observation, action, total, next_observation, goes_on * self._gamma**length)
        for name, value in zip(self.FIELDS, values, strict=True):
            self.arrays[name][row] = value
        self.added += 1

    def sample(self, size: int, rng: np.random.Generator) -> Batch:
        """``size`` transitions, drawn uniformly with replacement."""
        rows = rng.integers(len(self), size=size)
        return Batch(**{n: torch.from_numpy(self.arrays[n][rows]) for n in self.FIELDS})

    def drop_pending(self) -> None:
        """Forget the decisions that still wait for the n-th reward behind them."""
        self._pending.clear()

    def filled(self) -> dict[str, NDArray[np.generic]]:
        """The part in use of each array; only between episodes is it the whole state."""
        if self._pending:
            raise RuntimeError("the replay is saved between episodes only")
        return {name: self.arrays[name][: len(self)] for name in self.FIELDS}

    def blank(self, added: int) -> dict[str, NDArray[np.generic]]:
        """Arrays of the shapes and types that ``filled`` has after ``added`` transitions."""
        return {name: self.arrays[name][: min(added, self.capacity)] for name in self.FIELDS}

    def restore(self, arrays: dict[str, NDArray[np.generic]], added: int) -> None:
        """Take back what ``filled`` gave."""
        for name in self.FIELDS:
            self.arrays[name][: len(arrays[name])] = arrays[name]
        self.added = added
        self._pending.clear()
