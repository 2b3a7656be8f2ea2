"""A map of capability: where in the plane of two settings a policy reaches the finish.

In: axes, and a function that plays the episodes of cells. Out: the success and θ̂_R of every cell of
the grid. A coarse grid is played first, and then the cells where success changes; cells between
equal ones are interpolated and marked as such.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from flipperctl.evaluation.axes import Axis
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episode import EpisodeResult

Index = tuple[int, int]
"""Indices of a cell: along the horizontal and along the vertical axis."""
PlayCells = Callable[[Sequence[Index], str], Iterator[tuple[Index, Sequence[EpisodeResult]]]]
"""Plays the episodes of cells, shown under a label, and yields them as they are finished; fewer
cells if it was stopped."""
EPISODES = 10
"""Episodes of a cell, unless the user chooses another number [-]."""
TOLERANCE = 0.1
"""Largest distance of success from 0 or 1 at which cells between are not played [-]."""
_COARSE = 4
"""Least number of intervals of the coarse grid along an axis with enough values [-]."""


@dataclass(frozen=True)
class Cell:
    """The result of one cell of a map."""

    episodes: int
    """Number of episodes that were played; 0 if the cell is interpolated."""
    success: float
    """Fraction of the episodes that reached the finish, 0 to 1."""
    pitch_variation: float | None
    """Mean θ̂_R at 100 Hz of the episodes that reached the finish [rad]; None if none did."""
    outcomes: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of(cls, episodes: Sequence[EpisodeResult]) -> Cell:
        """Return the result of a cell's episodes."""
        reached = [e.pitch_variation_100hz for e in episodes if e.reached]
        return cls(
            len(episodes),
            len(reached) / len(episodes),
            sum(reached) / len(reached) if reached else None,
            dict(Counter(str(e.outcome) for e in episodes)),
        )


@dataclass(frozen=True)
class CapabilityMap:
    """The cells of a policy's map."""

    controller: str
    terrain: str
    axes: tuple[Axis, Axis]
    """The horizontal and the vertical axis."""
    cells: Mapping[Index, Cell]
    """Every cell of the grid; those that were played alone if the map was interrupted."""
    episodes: int
    """Episodes of each cell that was played."""
    seed: int
    """Seed of the evaluation."""
    conditions: Conditions
    """Conditions to which the values of the axes are applied."""
    interrupted: bool = False
    failures: Mapping[Index, EpisodeResult] = field(default_factory=dict)
    """The first failure of each cell that has one."""

    @property
    def played(self) -> int:
        """Number of cells whose episodes were played."""
        return sum(cell.episodes > 0 for cell in self.cells.values())

    @property
    def size(self) -> Index:
        """Number of values along the horizontal and along the vertical axis."""
        first, second = self.axes
        return len(first.values), len(second.values)

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield a flat row for each cell, from the lowest values on."""
        first, second = self.axes
        for (i, j), cell in sorted(self.cells.items(), key=lambda item: item[0][::-1]):
            yield {
                first.name: first.values[i],
                second.name: second.values[j],
                "episodes": cell.episodes,
                "success_rate": cell.success,
                "pitch_variation_100hz": cell.pitch_variation,
                **{name: cell.outcomes.get(name, 0) for name in self._outcomes()},
            }

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        axes = [
            {"name": a.name, "settings": list(a.keys), "unit": a.unit, "values": list(a.values)}
            for a in self.axes
        ]
        return {
            "controller": self.controller,
            "terrain": self.terrain,
            **({"interrupted": True} if self.interrupted else {}),
            "axes": axes,
            "episodes_per_cell": self.episodes,
            "seed": self.seed,
            "cells_played": self.played,
            "conditions": self.conditions.to_dict(),
            "cells": list(self.rows()),
        }

    def _outcomes(self) -> list[str]:
        return sorted({name for cell in self.cells.values() for name in cell.outcomes})


@dataclass(frozen=True)
class _Block:
    """A rectangle of cells, with the indices of its sides."""

    left: int
    right: int
    low: int
    high: int

    @property
    def corners(self) -> tuple[Index, Index, Index, Index]:
        """Lower left, lower right, upper left and upper right cell."""
        left, right, low, high = self.left, self.right, self.low, self.high
        return (left, low), (right, low), (left, high), (right, high)

    @property
    def divisible(self) -> bool:
        return self.right - self.left > 1 or self.high - self.low > 1

    def contains(self, index: Index) -> bool:
        return self.left <= index[0] <= self.right and self.low <= index[1] <= self.high

    def parts(self) -> Iterator[_Block]:
        """Yield the two or four blocks into which the block is divided."""
        for left, right in _halves(self.left, self.right):
            for low, high in _halves(self.low, self.high):
                yield _Block(left, right, low, high)


def sample_cells(
    size: Index, play: PlayCells, tolerance: float = TOLERANCE
) -> tuple[dict[Index, Cell], bool]:
    """Return the cells of a grid of ``size`` values along each axis, and whether it is complete.

    The grid is divided into blocks, whose corners are played. A block is divided further unless
    the success of all its played cells is within ``tolerance`` of 1, or of all within it of 0; a
    negative tolerance plays every cell. The other cells are interpolated between the corners of
    their block. If the playing was stopped, only cells that were played are returned.
    """
    cells: dict[Index, Cell] = {}
    columns, rows = (_coarse(count) for count in size)
    blocks = [_Block(*column, *row) for column in columns for row in rows]
    while True:
        missing = sorted({c for block in blocks for c in block.corners if c not in cells})
        label = f"map, {len(cells)} of at most {size[0] * size[1]} cells played"
        cells |= {index: Cell.of(episodes) for index, episodes in play(missing, label)}
        if any(index not in cells for index in missing):
            return cells, False
        divided = [b for b in blocks if b.divisible and _changes(b, cells, tolerance)]
        if not divided:
            return cells | _interpolated(blocks, cells), True
        blocks = [b for b in blocks if b not in divided] + [p for b in divided for p in b.parts()]


def _coarse(count: int) -> list[tuple[int, int]]:
    """Return the intervals of the coarse grid along an axis of ``count`` values."""
    step = 1
    while 2 * step * _COARSE <= count - 1:
        step *= 2
    ends = [*range(0, count - 1, step), count - 1]
    return list(pairwise(ends))


def _halves(first: int, last: int) -> list[tuple[int, int]]:
    middle = (first + last) // 2
    return [(first, middle), (middle, last)] if last - first > 1 else [(first, last)]


def _changes(block: _Block, cells: Mapping[Index, Cell], tolerance: float) -> bool:
    """Return whether success changes within a block; neighbours may have played cells inside it."""
    found = [cell.success for index, cell in cells.items() if block.contains(index)]
    return not (min(found) >= 1 - tolerance or max(found) <= tolerance)


def _interpolated(blocks: Iterable[_Block], cells: Mapping[Index, Cell]) -> dict[Index, Cell]:
    """Return the cells that were not played, each linear between the corners of its block."""
    found = {}
    for block in blocks:
        corners = [cells[corner] for corner in block.corners]
        for i in range(block.left, block.right + 1):
            for j in range(block.low, block.high + 1):
                if (i, j) not in cells:
                    found[i, j] = _between(corners, _weights(block, i, j))
    return found


def _weights(block: _Block, i: int, j: int) -> list[float]:
    """Return the weights of the corners of a block at the cell (i, j); their sum is 1."""
    x = (i - block.left) / (block.right - block.left)
    y = (j - block.low) / (block.high - block.low)
    return [(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y]


def _between(corners: Sequence[Cell], weights: Sequence[float]) -> Cell:
    pairs = list(zip(corners, weights, strict=True))
    success = sum(cell.success * weight for cell, weight in pairs)
    near = [(c.pitch_variation, weight) for c, weight in pairs if weight > 0]
    swings = [value * weight for value, weight in near if value is not None]
    return Cell(0, success, sum(swings) if len(swings) == len(near) else None)
