"""Replay of n-step transitions in preallocated arrays, drawn uniformly or by their errors.

In: decisions in chronological order. Out: random batches of (observation, action, discounted sum
of n rewards, observation n decisions later, discount of its value).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.memory import gigabytes
from flipperctl.agent.priorities import Priorities
from flipperctl.errors import ConfigError

_LEAST_ERROR = 1e-3
"""Added to errors, so that no transition is lost for good; the paper's ε [-]."""
_Label = NDArray[np.float32] | None


def row_bytes(size: int, labels: int = 0) -> int:
    """Return the memory of one transition [B].

    ``size``: length of an input row; ``labels``: length of a label, 0 without one.
    """
    return 2 * 4 * size + 8 + 4 + 4 + 4 * labels


@dataclass(frozen=True)
class Batch:
    """A batch of n-step transitions as tensors."""

    observation: torch.Tensor
    """Input rows of the network, (B, frames · (N + 3)) float32 in SI units."""
    action: torch.Tensor
    """Indices into ``ACTIONS``, (B,) int64."""
    reward: torch.Tensor
    """Sums of up to n discounted rewards, (B,) float32 [-]."""
    next_observation: torch.Tensor
    """Input rows up to n decisions later, (B, frames · (N + 3)) float32 in SI units."""
    discount: torch.Tensor
    """Factors of the next value: γⁿ, or 0 without bootstrapping, (B,) float32 [-]."""
    label: torch.Tensor | None = None
    """The teacher's distribution over actions, (B, 9) float32; zeros without a label."""
    weight: torch.Tensor | None = None
    """Weights of the errors, (B,) float32, at most 1; None if all are 1 [-]."""
    rows: NDArray[np.int64] | None = None
    """Rows of the replay, (B,), if their priorities depend on the errors."""

    def part(self, part: slice) -> Batch:
        """Return a part of the batch."""
        return self._each(lambda tensor: tensor[part])

    def to(self, device: torch.device) -> Batch:
        """Return the batch on ``device``."""
        return self if device.type == "cpu" else self._each(lambda tensor: tensor.to(device))

    def _each(self, change: Callable[[torch.Tensor], torch.Tensor]) -> Batch:
        tensors = {name: getattr(self, name) for name in (*Replay.FIELDS, "label", "weight")}
        changed: dict[str, Any] = {n: change(t) for n, t in tensors.items() if t is not None}
        return replace(self, **changed)


class Replay:
    """A ring buffer of ``capacity`` transitions, with labels if there is a teacher."""

    FIELDS = ("observation", "action", "reward", "next_observation", "discount")

    def __init__(
        self,
        capacity: int,
        size: int,
        n_step: int,
        gamma: float,
        labels: int = 0,
        *,
        cut: bool = False,
        exponent: float = 0.0,
    ) -> None:
        """Allocate the arrays; ``size`` is the length of an input row, ``labels`` of a label.

        ``cut``: whether a sum of rewards ends before the next random action. ``exponent``: power
        of a transition's last error that is proportional to its probability; 0 is uniform.

        Raises:
            ConfigError: there is not enough memory.
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
            if labels:
                self.arrays["label"] = np.zeros((capacity, labels), np.float32)
            if exponent:
                self.arrays["priority"] = np.zeros(capacity, np.float32)
        except MemoryError as error:
            needed = gigabytes(capacity * row_bytes(size, labels))
            raise ConfigError(
                f"agent.replay_size: {capacity:,} transitions of {size} numbers each take "
                f"{needed} of memory, more than is available; lower it"
            ) from error
        self.added = 0
        self.kept = 0
        """Number of first transitions, which are never overwritten."""
        self._gamma = gamma
        self._pending: deque[tuple[NDArray[np.float32], int, float, _Label]] = deque()
        self._n_step, self._cut, self._exponent = n_step, cut, exponent
        self._priorities = Priorities(capacity) if exponent else None

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
        explored: bool = False,
        label: _Label = None,
    ) -> None:
        """Add one decision.

        ``over``: whether it ended the episode; ``bootstrap``: whether the target still includes the
        value after that end; ``explored``: whether the action was random; ``label``: the teacher's
        distribution over actions, if any.
        """
        while self._cut and explored and self._pending:
            self._flush(observation, 1.0)
        self._pending.append((observation, action, reward, label))
        continues = 1.0 if bootstrap or not over else 0.0
        if len(self._pending) == self._n_step:
            self._flush(next_observation, continues)
        while over and self._pending:
            self._flush(next_observation, continues)

    def _flush(self, next_observation: NDArray[np.float32], continues: float) -> None:
        total = 0.0
        for _, _, reward, _ in reversed(self._pending):
            total = reward + self._gamma * total
        length = len(self._pending)
        observation, action, _, label = self._pending.popleft()
        row = self.added
        if row >= self.capacity:
            row = self.kept + (row - self.kept) % (self.capacity - self.kept)
        values = (observation, action, total, next_observation, continues * self._gamma**length)
        for name, value in zip(self.FIELDS, values, strict=True):
            self.arrays[name][row] = value
        if "label" in self.arrays:
            self.arrays["label"][row] = 0.0 if label is None else label
        self._set_priorities(np.array([row]), np.ones(1, np.float32))
        self.added += 1

    def sample(self, size: int, rng: np.random.Generator, correction: float = 0.0) -> Batch:
        """Return ``size`` transitions, drawn with replacement, uniformly or by their errors.

        ``correction``: fraction β of the importance weights' logarithm, which makes up for
        probabilities that are not uniform [-].
        """
        if self._priorities is None:
            return self._batch(rng.integers(len(self), size=size))
        rows, probability = self._priorities.draw(size, rng)
        weight = (len(self) * probability) ** -correction
        weight = (weight / weight.max()).astype(np.float32)
        return replace(self._batch(rows), weight=torch.from_numpy(weight), rows=rows)

    def _batch(self, rows: NDArray[np.int64]) -> Batch:
        """Return the transitions of ``rows``, (B,)."""
        names = (*self.FIELDS, "label") if "label" in self.arrays else self.FIELDS
        found: dict[str, Any] = {n: torch.from_numpy(self.arrays[n][rows]) for n in names}
        return Batch(**found)

    def rate(self, rows: NDArray[np.int64], errors: NDArray[np.float32]) -> None:
        """Set the priorities of sampled ``rows``, (R,), by their absolute ``errors``, (R,)."""
        self._set_priorities(rows, np.minimum(errors + _LEAST_ERROR, 1.0) ** self._exponent)

    def _set_priorities(self, rows: NDArray[np.int64], priorities: NDArray[np.float32]) -> None:
        if self._priorities is not None:
            self.arrays["priority"][rows] = priorities
            self._priorities.set(rows, self.arrays["priority"][rows])

    def keep(self) -> None:
        """Protect all transitions added so far from being overwritten.

        Raises:
            RuntimeError: they leave no room for more.
        """
        if self.added >= self.capacity:
            raise RuntimeError(f"{self.added} kept transitions fill the replay")
        self.kept = self.added

    def drop_pending(self) -> None:
        """Discard the decisions that still lack their n-th reward."""
        self._pending.clear()

    def filled(self) -> dict[str, NDArray[np.generic]]:
        """Return the used part of each array.

        Raises:
            RuntimeError: an episode is running, so the arrays lack its last decisions.
        """
        if self._pending:
            raise RuntimeError("the replay can be saved only between episodes")
        return {name: array[: len(self)] for name, array in self.arrays.items()}

    def blank(self, added: int) -> dict[str, NDArray[np.generic]]:
        """Return arrays of the shapes and types of ``filled`` after ``added`` transitions."""
        return {n: array[: min(added, self.capacity)] for n, array in self.arrays.items()}

    def restore(self, arrays: dict[str, NDArray[np.generic]], added: int, kept: int = 0) -> None:
        """Restore the arrays that ``filled`` returned after ``added`` transitions.

        ``kept`` of them are never overwritten.
        """
        for name, array in self.arrays.items():
            array[: len(arrays[name])] = arrays[name]
        self.added, self.kept = added, kept
        if self._priorities is not None:
            rows = np.arange(len(self))
            self._priorities.set(rows, self.arrays["priority"][rows])
        self._pending.clear()
