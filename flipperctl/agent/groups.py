"""A ring buffer of groups of valued states, and random batches of them.

In: ``StateGroups`` from a teacher. Out: tensors of observations and values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.api import ACTIONS, StateGroups


@dataclass(frozen=True)
class GroupBatch:
    """B groups of K states as tensors."""

    observation: torch.Tensor
    """(B, K, N + 3) float32 in SI units."""
    values: torch.Tensor
    """Discounted return from each action on, (B, K, 9) float32 [-]."""

    def to(self, device: torch.device) -> GroupBatch:
        """Return the batch on ``device``."""
        return GroupBatch(self.observation.to(device), self.values.to(device))


class GroupMemory:
    """The newest groups; the arrays are allocated with the first ones, which tell their size."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.added = 0
        self._observations = np.zeros((0, 0, 0), np.float32)
        self._values = np.zeros((0, 0, 0), np.float32)

    def __len__(self) -> int:
        return min(self.added, self.capacity)

    @property
    def states(self) -> int:
        """Number of states in a group; 0 before the first groups [-]."""
        return self._observations.shape[1]

    def add(self, groups: StateGroups) -> None:
        """Add groups, each in the place of the oldest once the memory is full."""
        if not self._observations.size:
            self._observations = np.zeros(
                (self.capacity, *groups.observations.shape[1:]), np.float32
            )
            self._values = np.zeros((self.capacity, *groups.values.shape[1:]), np.float32)
        rows = (self.added + np.arange(len(groups.values))) % self.capacity
        self._observations[rows], self._values[rows] = groups.observations, groups.values
        self.added += len(groups.values)

    def sample(self, size: int, rng: np.random.Generator) -> GroupBatch:
        """Return ``size`` groups, drawn uniformly with replacement."""
        rows = rng.integers(len(self), size=size)
        return GroupBatch(
            torch.from_numpy(self._observations[rows]), torch.from_numpy(self._values[rows])
        )

    def filled(self) -> dict[str, NDArray[np.generic]]:
        """Return the used part of each array; nothing before the first groups."""
        if not self.added:
            return {}
        return {
            "observations": self._observations[: len(self)],
            "values": self._values[: len(self)],
        }

    def restore(self, arrays: dict[str, NDArray[np.generic]], added: int, size: int) -> None:
        """Restore the arrays that ``filled`` returned after ``added`` groups.

        ``size``: length of an observation.

        Raises:
            ValueError: the arrays are not those of so many groups.
        """
        self.added = 0
        if not added:
            if arrays:
                raise ValueError("there are groups, but none were added")
            return
        count = min(added, self.capacity)
        if set(arrays) != {"observations", "values"}:
            raise ValueError(f"there are {sorted(arrays)}; observations and values are allowed")
        seen, values = arrays["observations"], arrays["values"]
        shapes = seen.shape == (count, *seen.shape[1:2], size) and values.shape == (
            *seen.shape[:2],
            len(ACTIONS),
        )
        if not shapes or seen.dtype != np.float32 or values.dtype != np.float32:
            raise ValueError(f"shapes are {seen.shape} and {values.shape} for {count} groups")
        if not (np.isfinite(seen).all() and np.isfinite(values).all()):
            raise ValueError("a number is not finite")
        self.add(StateGroups(np.asarray(seen, np.float32), np.asarray(values, np.float32)))
        self.added = added
