"""Replay of n-step transitions and of groups of valued states, in preallocated arrays.

In: decisions in chronological order, or ``StateGroups`` from a teacher. Out: random batches of
(observation, action, discounted sum of n rewards, observation n decisions later, discount of its
value), or of observations and values. Each transition may have a priority, which says how often it
is drawn.

Linux grants more memory than exists and kills the process that uses it. The sizes that a
configuration asks for are therefore compared with the free memory first.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.api import ACTIONS, StateGroups
from flipperctl.core.risk import LAGS, resemblances
from flipperctl.errors import ConfigError


def available() -> int | None:
    """Return the memory of this machine that is free [B]; None if unknown."""
    with suppress(OSError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    return None


def require(size: int, what: str, advice: str) -> None:
    """Check that ``size`` [B] fits into the free memory.

    The error reads ``what``, then the needed and the free memory, then ``advice``.
    """
    free = available()
    if free is not None and size > free:
        raise ConfigError(
            f"{what} {gigabytes(size)} of memory, but {gigabytes(free)} are free; {advice}"
        )


def gigabytes(size: int) -> str:
    """Return a size [B] as text in gigabytes."""
    return f"{size / 1e9:,.1f} GB" if size < 1e15 else f"{size / 1e9:.1e} GB"


_Row = NDArray[np.float32] | None
UNKNOWN: Final = -1.0
"""Label of a transition whose episode has not ended, or was not played by this training [-]."""


def _columns(
    size: int, labels: int, privileged: int, risk: bool, prioritised: bool = False
) -> dict[str, tuple[tuple[int, ...], type[np.generic]]]:
    """Return the shape and the type of a transition's row in each array of a replay."""
    # Columns by need: a run without a teacher, privileged states, a risk or priorities pays nothing
    # for them.
    row, number = ((size,), np.float32), ((), np.float32)
    layout: dict[str, tuple[tuple[int, ...], type[np.generic]]] = {
        "observation": row,
        "action": ((), np.int64),
        "reward": number,
        "next_observation": row,
        "discount": number,
    }
    if labels:
        layout["label"] = ((labels,), np.float32)
    if privileged:
        layout["privileged"] = layout["next_privileged"] = ((privileged,), np.float32)
    if risk:
        layout |= {"failing": number, "resembles": ((len(LAGS),), np.float32)}
    if prioritised:
        layout["priority"] = number
    return layout


_LIMITS: Final[dict[str, tuple[float, float]]] = {
    "discount": (0.0, 1.0),
    "label": (0.0, 1.0),
    "failing": (UNKNOWN, 1.0),
    "resembles": (0.0, 1.0),
    "priority": (0.0, math.inf),
}
"""Array of a replay → its smallest and largest number."""


def row_bytes(size: int, labels: int = 0, privileged: int = 0, *, risk: bool = False) -> int:
    """Return the memory of one transition [B].

    ``size``: length of an input row; ``labels``: length of a label, 0 without one;
    ``privileged``: length of a privileged state, 0 without one; ``risk``: whether a risk is learnt.
    """
    columns = _columns(size, labels, privileged, risk).values()
    return sum(math.prod(shape) * np.dtype(kind).itemsize for shape, kind in columns)


@dataclass(frozen=True)
class Batch:
    """A batch of n-step transitions as tensors."""

    observation: torch.Tensor
    """Input rows of the network, (B, frames · n) float32 in SI units."""
    action: torch.Tensor
    """Indices of actions, (B,) int64."""
    reward: torch.Tensor
    """Sums of up to n discounted rewards, (B,) float32 [-]."""
    next_observation: torch.Tensor
    """Input rows up to n decisions later, (B, frames · n) float32 in SI units."""
    discount: torch.Tensor
    """Factors of the next value: γⁿ, or 0 without bootstrapping, (B,) float32 [-]."""
    label: torch.Tensor | None = None
    """The teacher's distribution over actions, (B, A) float32; zeros without a label."""
    privileged: torch.Tensor | None = None
    """Privileged states at ``observation``, (B, P) float32, if the training has them."""
    next_privileged: torch.Tensor | None = None
    """Privileged states at ``next_observation``, (B, P) float32."""
    failing: torch.Tensor | None = None
    """1 where the episode failed soon, else 0, or ``UNKNOWN``, (B,) float32, for a risk."""
    resembles: torch.Tensor | None = None
    """Resemblances of the newest observation to earlier ones, (B, lags) float32, for a risk."""
    priority: torch.Tensor | None = None
    """Priorities by which the rows were drawn, (B,) float32, if transitions have any."""
    weight: torch.Tensor | None = None
    """Weights of the rows' losses, (B,) float32 of mean 1; None: all equal."""

    def rows(self, part: slice | torch.Tensor) -> Batch:
        """Return a part of the batch: a slice, or the rows of these indices, (R,)."""
        return Batch(**{name: tensor[part] for name, tensor in self._tensors().items()})

    def to(self, device: torch.device) -> Batch:
        """Return the batch on ``device``."""
        if device.type == "cpu":
            return self
        return Batch(**{name: tensor.to(device) for name, tensor in self._tensors().items()})

    def _tensors(self) -> dict[str, torch.Tensor]:
        return {name: tensor for name, tensor in vars(self).items() if tensor is not None}


class Replay:
    """A ring buffer of ``capacity`` transitions, with labels if there is a teacher."""

    def __init__(
        self,
        capacity: int,
        size: int,
        n_step: int,
        gamma: float,
        labels: int = 0,
        *,
        actions: int = len(ACTIONS),
        privileged: int = 0,
        risk_horizon: int = 0,
        newest: int = 0,
        cut_at_random: bool = False,
        prioritised: bool = False,
    ) -> None:
        """Allocate the arrays; ``size`` is the length of an input row, ``labels`` of a label.

        ``actions``: number of actions. ``privileged``: length of the privileged states, 0 without
        them. ``risk_horizon``: number of decisions before a failure that ``failing`` marks, 0
        without it; ``newest``: length of the newest observation in a row, n, which it needs.
        ``cut_at_random``: whether a sum of rewards ends before the next random action.
        ``prioritised``: whether transitions have priorities.
        """
        self.capacity, risk = capacity, risk_horizon > 0
        self.prioritised = prioritised
        self._limits = {**_LIMITS, "action": (0.0, actions - 1)}
        # Linux grants arrays of zeros without backing them; only absurd sizes fail here.
        try:
            self.arrays: dict[str, NDArray[Any]] = {
                name: np.zeros((capacity, *shape), kind)
                for name, (shape, kind) in _columns(
                    size, labels, privileged, risk, prioritised
                ).items()
            }
            if risk:
                self.arrays["failing"].fill(UNKNOWN)
        except MemoryError as error:
            needed = gigabytes(capacity * row_bytes(size, labels, privileged, risk=risk))
            raise ConfigError(
                f"agent.replay_size: {capacity:,} transitions of {size} numbers each take "
                f"{needed} of memory, more than is available; lower it"
            ) from error
        self.added = 0
        self.kept = 0
        """Number of first transitions, which are never overwritten."""
        self.largest = 1.0
        """Largest priority after the last update, with which new transitions begin."""
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

        ``over``: whether it ended the episode. ``bootstrap``: whether the target still includes the
        value after that end. ``explored``: whether the action was random. ``failed``: at the end,
        whether the episode failed, None if its risk shall not be learnt. ``label``: the teacher's
        distribution over actions, if any. ``privileged`` and ``next_privileged``: the privileged
        states at both observations, if the training has them.
        """
        # A random action ends the sums before it, which bootstrap from the state before it.
        while self._cut_at_random and explored and self._pending:
            self._flush(observation, privileged, 1.0)
        self._pending.append((observation, action, reward, label, privileged))
        # The oldest decision is complete once it has n rewards.
        continues = 1.0 if bootstrap or not over else 0.0
        if len(self._pending) == self._n_step:
            self._flush(next_observation, next_privileged, continues)
        # At the end of an episode all others are complete too, with shorter sums.
        while over and self._pending:
            self._flush(next_observation, next_privileged, continues)
        if over:
            self._mark_episode(failed)

    def _flush(
        self, next_observation: NDArray[np.float32], next_privileged: _Row, continues: float
    ) -> None:
        # R = r_0 + γ·r_1 + … backwards, which multiplies once per reward.
        total = 0.0
        for _, _, reward, _, _ in reversed(self._pending):
            total = reward + self._gamma * total
        length = len(self._pending)
        observation, action, _, label, privileged = self._pending.popleft()
        values = {
            "observation": observation,
            "action": action,
            "reward": total,
            "next_observation": next_observation,
            "discount": continues * self._gamma**length,
            "label": 0.0 if label is None else label,
            "privileged": privileged,
            "next_privileged": next_privileged,
            "failing": UNKNOWN,
            "priority": self.largest,
        }
        # Arrays that the run does not need take nothing; resemblances come with the episode's end.
        row = self._row_of(self.added)
        for name, array in self.arrays.items():
            if name in values:
                array[row] = values[name]
        self.added += 1
        self._episode += 1

    def _row_of(self, number: int) -> int:
        """Return the row of a transition, counted from 0."""
        # Below the capacity rows fill up; later ones cycle past the protected ones at the front.
        if number < self.capacity:
            return number
        return self.kept + (number - self.kept) % (self.capacity - self.kept)

    def _mark_episode(self, failed: bool | None) -> None:
        """Mark each transition of the episode that has ended, unless it is overwritten already."""
        if "failing" in self.arrays and failed is not None:
            # A long episode may have overwritten its own first transitions.
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
        return self._batch(rows if among is None else among[rows])

    def sample_by_priority(
        self, size: int, steps: int, rng: np.random.Generator, correction: float
    ) -> tuple[NDArray[np.int64], Batch]:
        """Return rows and their transitions, drawn in proportion to their priorities.

        The draw is stratified: each of ``steps`` parts of the batch, which follow one another, has
        transitions of the whole cumulative sum (Schaul et al. 2016, Appendix B.2.1).
        ``correction``: exponent β of the weights (N · p)^-β, which are divided by their mean.
        """
        sums = np.cumsum(self.arrays["priority"][: len(self)], dtype=np.float64)
        # One draw from each of ``size`` equal parts of the sum, dealt out to the steps in turn.
        strata = (np.arange(size) + rng.random(size)) / size
        dealt = strata.reshape(-1, steps).T.reshape(-1)
        rows = np.minimum(np.searchsorted(sums, dealt * sums[-1], "right"), len(self) - 1)
        batch = self._batch(rows)
        assert batch.priority is not None  # as in every batch of such a replay
        weight = batch.priority**-correction
        return rows, replace(batch, weight=weight / weight.mean())

    def set_priorities(self, rows: NDArray[np.int64], priorities: NDArray[np.floating]) -> None:
        """Set the priorities of rows; of a row that stands there twice, the last one counts."""
        self.arrays["priority"][rows] = priorities
        self._measure_priorities()

    def _measure_priorities(self) -> None:
        # New transitions keep the maximum as it is, so that a restored replay has the same.
        if self.prioritised and len(self):
            self.largest = float(self.arrays["priority"][: len(self)].max())

    def newest(self, count: int) -> Batch:
        """Return the newest transitions, oldest first; fewer if the replay holds fewer."""
        first = max(self.added - count, self.added - (self.capacity - self.kept), self.kept)
        return self._batch([self._row_of(number) for number in range(first, self.added)])

    def _batch(self, rows: NDArray[np.int64] | list[int]) -> Batch:
        return Batch(**{n: torch.from_numpy(array[rows]) for n, array in self.arrays.items()})

    def keep(self) -> None:
        """Protect all transitions added so far from being overwritten."""
        if self.added >= self.capacity:
            raise RuntimeError(f"{self.added} kept transitions fill the replay")
        self.kept = self.added

    def take_back(self) -> None:
        """Remove the transitions of the running episode."""
        self.added -= self._episode
        # Decisions without their n-th reward belong to the same episode.
        self.drop_pending()

    def drop_pending(self) -> None:
        """Discard the decisions that still lack their n-th reward."""
        self._pending.clear()
        self._episode = 0

    def filled(self) -> dict[str, NDArray[np.generic]]:
        """Return the used part of each array."""
        if self._pending:
            raise RuntimeError("the replay can be saved only between episodes")
        return {name: array[: len(self)] for name, array in self.arrays.items()}

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return the used part of each array for a checkpoint, between episodes."""
        return {name: torch.from_numpy(array) for name, array in self.filled().items()}

    def restore_tensors(
        self, tensors: Mapping[str, torch.Tensor], added: int, protected: int = 0
    ) -> None:
        """Restore what ``tensors`` returned; see ``restore``."""
        self.restore({name: tensor.numpy() for name, tensor in tensors.items()}, added, protected)

    def restore(
        self, arrays: dict[str, NDArray[np.generic]], added: int, protected: int = 0
    ) -> None:
        """Restore the arrays that ``filled`` returned after ``added`` transitions.

        The first ``protected`` of them are never overwritten.

        Raises:
            ValueError: names, shapes, types or numbers do not fit this replay.
        """
        if not 0 <= protected <= added or protected >= self.capacity:
            raise ValueError(
                f"{added} transitions with {protected} kept do not fit {self.capacity}"
            )
        # Presence, layout, then numbers: an action out of range would fail far from here.
        if wrong := arrays.keys() ^ self.arrays.keys():
            raise ValueError(f"{min(wrong)} is missing or unknown")
        for name, array in self.arrays.items():
            values: NDArray[Any] = arrays[name]
            wanted = array[: min(added, self.capacity)]
            if values.shape != wanted.shape or values.dtype != wanted.dtype:
                raise ValueError(
                    f"{name} is {values.dtype} {values.shape}; {wanted.dtype} {wanted.shape} is "
                    "needed"
                )
            least, most = self._limits.get(name, (-math.inf, math.inf))
            if not (np.isfinite(values).all() and ((values >= least) & (values <= most)).all()):
                raise ValueError(f"{name} is not finite, or lies outside of {least:g} to {most:g}")
            wanted[:] = values
        self.added, self.kept = added, protected
        self._measure_priorities()
        self.drop_pending()


@dataclass(frozen=True)
class GroupBatch:
    """B groups of K states as tensors."""

    observation: torch.Tensor
    """(B, K, n) float32 in SI units."""
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
        self._arrays: dict[str, NDArray[np.float32]] = {}

    def __len__(self) -> int:
        return min(self.added, self.capacity)

    @property
    def states(self) -> int:
        """Number of states in a group; 0 before the first groups [-]."""
        return self._arrays["values"].shape[1] if self._arrays else 0

    def add(self, groups: StateGroups) -> None:
        """Add groups, each in the place of the oldest once the memory is full."""
        count = len(groups.values)
        rows = (self.added + np.arange(count)) % self.capacity
        for name in ("observations", "values"):
            new = getattr(groups, name)
            if name not in self._arrays:
                self._arrays[name] = np.zeros((self.capacity, *new.shape[1:]), np.float32)
            self._arrays[name][rows] = new
        self.added += count

    def sample(self, size: int, rng: np.random.Generator) -> GroupBatch:
        """Return ``size`` groups, drawn uniformly with replacement."""
        rows = rng.integers(len(self), size=size)
        return GroupBatch(*(torch.from_numpy(array[rows]) for array in self._arrays.values()))

    def filled(self) -> dict[str, NDArray[np.generic]]:
        """Return the used part of each array; nothing before the first groups."""
        return {name: array[: len(self)] for name, array in self._arrays.items() if self.added}

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return the used part of each array for a checkpoint, between episodes."""
        return {name: torch.from_numpy(array) for name, array in self.filled().items()}

    def restore_tensors(self, tensors: Mapping[str, torch.Tensor], added: int, size: int) -> None:
        """Restore what ``tensors`` returned; see ``restore``."""
        self.restore({name: tensor.numpy() for name, tensor in tensors.items()}, added, size)

    def restore(self, arrays: dict[str, NDArray[np.generic]], added: int, size: int) -> None:
        """Restore the arrays that ``filled`` returned after ``added`` groups.

        ``size``: length of an observation.
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
        # Groups of all episodes have one number of states, which the file tells.
        states = seen.shape[1:2]
        shapes = seen.shape, values.shape
        if shapes != ((count, *states, size), (count, *states, len(ACTIONS))) or any(
            array.dtype != np.float32 for array in (seen, values)
        ):
            raise ValueError(f"shapes are {seen.shape} and {values.shape} for {count} groups")
        if not (np.isfinite(seen).all() and np.isfinite(values).all()):
            raise ValueError("a number is not finite")
        # Rows lie as they did: the number of all groups added says which is overwritten next.
        self.add(StateGroups(np.asarray(seen, np.float32), np.asarray(values, np.float32)))
        self.added = added
