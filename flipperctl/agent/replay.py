"""Uniform replay of n-step transitions in preallocated arrays.

In: decisions in chronological order. Out: random batches of (observation, action, discounted sum
of n rewards, observation n decisions later, discount of its value).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.memory import gigabytes
from flipperctl.core.risk import LAGS, resemblances
from flipperctl.errors import ConfigError

_Row = NDArray[np.float32] | None
UNKNOWN: Final = -1.0
"""Label of a transition whose episode has not ended, or was not played by this training [-]."""


def row_bytes(size: int, labels: int = 0, privileged: int = 0, *, risk: bool = False) -> int:
    """Return the memory of one transition [B].

    ``size``: length of an input row; ``labels``: length of a label, 0 without one;
    ``privileged``: length of a privileged state, 0 without one; ``risk``: whether a risk is learnt.
    """
    further = 4 * (1 + len(LAGS)) if risk else 0
    return 2 * 4 * (size + privileged) + 8 + 4 + 4 + 4 * labels + further


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
    privileged: torch.Tensor | None = None
    """Privileged states at ``observation``, (B, P) float32, if the training has them."""
    next_privileged: torch.Tensor | None = None
    """Privileged states at ``next_observation``, (B, P) float32."""
    failing: torch.Tensor | None = None
    """1 where the episode failed soon, else 0, or ``UNKNOWN``, (B,) float32, for a risk."""
    resembles: torch.Tensor | None = None
    """How much the newest observation resembles those before it, (B, lags) float32, likewise."""

    def rows(self, part: slice | torch.Tensor) -> Batch:
        """Return a part of the batch: a slice, or the rows of these indices, (R,)."""
        return Batch(**{name: tensor[part] for name, tensor in self._tensors().items()})

    def to(self, device: torch.device) -> Batch:
        """Return the batch on ``device``."""
        if device.type == "cpu":
            return self
        return Batch(**{name: tensor.to(device) for name, tensor in self._tensors().items()})

    def _tensors(self) -> dict[str, torch.Tensor]:
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: tensor for name, tensor in found.items() if tensor is not None}


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
        privileged: int = 0,
        risk_horizon: int = 0,
        newest: int = 0,
        cut_at_random: bool = False,
    ) -> None:
        """Allocate the arrays; ``size`` is the length of an input row, ``labels`` of a label.

        ``privileged``: length of the privileged states, 0 without them. ``risk_horizon``: number of
        decisions before a failure that ``failing`` marks, 0 without it; ``newest``: length of the
        newest observation in a row, N + 3, which it needs. ``cut_at_random``: whether a sum of
        rewards ends before the next random action.

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
            if privileged:
                for name in ("privileged", "next_privileged"):
                    self.arrays[name] = np.zeros((capacity, privileged), np.float32)
            if risk_horizon:
                self.arrays["failing"] = np.full(capacity, UNKNOWN, np.float32)
                self.arrays["resembles"] = np.zeros((capacity, len(LAGS)), np.float32)
        except MemoryError as error:
            needed = gigabytes(
                capacity * row_bytes(size, labels, privileged, risk=risk_horizon > 0)
            )
            raise ConfigError(
                f"agent.replay_size: {capacity:,} transitions of {size} numbers each take "
                f"{needed} of memory, more than is available; lower it"
            ) from error
        self.added = 0
        self.kept = 0
        """Number of first transitions, which are never overwritten."""
        self._gamma = gamma
        self._pending: deque[tuple[NDArray[np.float32], int, float, _Row, _Row]] = deque()
        self._n_step, self._cut_at_random = n_step, cut_at_random
        self._risk_horizon, self._newest = risk_horizon, newest
        self._episode = 0  # transitions of the running episode

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
        failed: bool | None = None,
        label: _Row = None,
        privileged: _Row = None,
        next_privileged: _Row = None,
    ) -> None:
        """Add one decision.

        ``over``: whether it ended the episode; ``bootstrap``: whether the target still includes the
        value after that end; ``explored``: whether the action was random; ``failed``: at the end,
        whether the episode failed, None if its risk shall not be learnt; ``label``: the teacher's
        distribution over actions, if any; ``privileged`` and ``next_privileged``: the privileged
        states at both observations, if the training has them.
        """
        while self._cut_at_random and explored and self._pending:
            self._flush(observation, privileged, 1.0)
        self._pending.append((observation, action, reward, label, privileged))
        continues = 1.0 if bootstrap or not over else 0.0
        if len(self._pending) == self._n_step:
            self._flush(next_observation, next_privileged, continues)
        while over and self._pending:
            self._flush(next_observation, next_privileged, continues)
        if over:
            self._mark_episode(failed)

    def _flush(
        self, next_observation: NDArray[np.float32], next_privileged: _Row, continues: float
    ) -> None:
        total = 0.0
        for _, _, reward, _, _ in reversed(self._pending):
            total = reward + self._gamma * total
        length = len(self._pending)
        observation, action, _, label, privileged = self._pending.popleft()
        row = self._row_of(self.added)
        values = (observation, action, total, next_observation, continues * self._gamma**length)
        for name, value in zip(self.FIELDS, values, strict=True):
            self.arrays[name][row] = value
        if "label" in self.arrays:
            self.arrays["label"][row] = 0.0 if label is None else label
        if "privileged" in self.arrays:
            self.arrays["privileged"][row] = privileged
            self.arrays["next_privileged"][row] = next_privileged
        if "failing" in self.arrays:
            self.arrays["failing"][row] = UNKNOWN
        self.added += 1
        self._episode += 1

    def _row_of(self, number: int) -> int:
        """Return the row of a transition, counted from 0."""
        if number < self.capacity:
            return number
        return self.kept + (number - self.kept) % (self.capacity - self.kept)

    def _mark_episode(self, failed: bool | None) -> None:
        """Mark each transition of the episode that has ended, unless it is overwritten already."""
        if "failing" in self.arrays and failed is not None:
            first = max(self.added - self._episode, self.added - (self.capacity - self.kept))
            rows = [self._row_of(number) for number in range(first, self.added)]
            newest = self.arrays["observation"][rows, -self._newest :]
            self.arrays["resembles"][rows] = resemblances(newest)
            self.arrays["failing"][rows] = 0.0
            if failed:
                self.arrays["failing"][rows[-self._risk_horizon :]] = 1.0
        self._episode = 0

    def labelled(self) -> NDArray[np.int64]:
        """Return the rows of the transitions that have a label."""
        return np.flatnonzero(self.arrays["label"][: len(self)].any(axis=1))

    def sample(
        self, size: int, rng: np.random.Generator, among: NDArray[np.int64] | None = None
    ) -> Batch:
        """Return ``size`` transitions, drawn uniformly with replacement.

        ``among``: rows to draw from; None: all.
        """
        rows = rng.integers(len(self) if among is None else len(among), size=size)
        if among is not None:
            rows = among[rows]
        return Batch(**{n: torch.from_numpy(array[rows]) for n, array in self.arrays.items()})

    def newest(self, count: int) -> Batch:
        """Return the newest transitions, oldest first; fewer if the replay holds fewer."""
        first = max(self.added - count, self.added - (self.capacity - self.kept), self.kept)
        rows = [self._row_of(number) for number in range(first, self.added)]
        return Batch(**{n: torch.from_numpy(array[rows]) for n, array in self.arrays.items()})

    def keep(self) -> None:
        """Protect all transitions added so far from being overwritten.

        Raises:
            RuntimeError: they leave no room for more.
        """
        if self.added >= self.capacity:
            raise RuntimeError(f"{self.added} kept transitions fill the replay")
        self.kept = self.added

    def take_back(self) -> None:
        """Remove the transitions of the running episode."""
        self.added -= self._episode
        self.drop_pending()

    def drop_pending(self) -> None:
        """Discard the decisions that still lack their n-th reward."""
        self._pending.clear()
        self._episode = 0

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
        self.drop_pending()
