"""A map of capability: where in the plane of two settings a policy reaches the finish.

In: a scene, axes such as ``terrain.height=0.1:0.6,sim.friction=0.4:1.0``, and a player of episodes.
Out: success and pitch variation of every point of the grid. A coarse grid is played first, and then
the points where success changes; points between equal ones are interpolated and marked as such.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product
from pathlib import Path
from typing import Any

from flipperctl.errors import InterruptedRunError
from flipperctl.evaluation.plan import Entry
from flipperctl.evaluation.play import Player
from flipperctl.evaluation.replay import EpisodeRecord
from flipperctl.evaluation.rows import Episodes, Row
from flipperctl.evaluation.views.axes import DIGITS, Axis, Index, grid_config
from flipperctl.files import write_csv, write_json

Play = Callable[[Sequence[Index], str], Iterator[tuple[Index, Episodes]]]
"""Plays the episodes of grid points, shown under a label, and yields them as they are finished;
fewer points if it was stopped."""
Block = tuple[Index, Index]
"""A rectangle of points: the first and last index along the horizontal and the vertical axis."""
NAMES = ("map.json", "map.csv", "map.png", "failure_map_*.json")  # names of the files of a map
EPISODES = 10  # episodes of a grid point, unless the user chooses another number [-]
MOST_FAILURES = 20  # largest number of failures that are recorded [-]
_TOLERANCE = 0.1
"""Largest distance of success from 0 or 1 at which points between are not played [-]."""
_COARSE = 4  # least number of intervals of the coarse grid along an axis with enough values [-]


@dataclass(frozen=True)
class GridPoint:
    """The result of one point of a map."""

    episodes: int
    """Number of episodes that were played; 0 if the point is interpolated."""
    success: float
    """Fraction of the episodes that reached the finish, 0 to 1."""
    pitch_variation: float | None
    """Mean θ̂_R at 100 Hz of the episodes that reached the finish [rad]; None if none did."""
    outcomes: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of(cls, episodes: Episodes) -> GridPoint:
        """Return the result of a point's episodes."""
        reached = episodes.reached.values("pitch_variation_100hz")
        mean = sum(reached) / len(reached) if reached else None
        outcomes = dict(Counter(row["outcome"] for row in episodes))
        return cls(len(episodes), len(reached) / len(episodes), mean, outcomes)


@dataclass(frozen=True)
class CapabilityMap:
    """The points of a policy's map."""

    entry: Entry
    """The policy and the scene, to which the values of the axes are applied."""
    axes: tuple[Axis, Axis]
    """The horizontal and the vertical axis."""
    points: Mapping[Index, GridPoint]
    """Every point of the grid; those that were played alone if the map was interrupted."""
    interrupted: bool = False
    failures: Mapping[Index, Row] = field(default_factory=dict)
    """The first failure of each point that has one."""

    @property
    def played(self) -> int:
        """Number of points whose episodes were played."""
        return sum(point.episodes > 0 for point in self.points.values())

    @property
    def size(self) -> Index:
        """Number of values along the horizontal and along the vertical axis."""
        first, second = self.axes
        return len(first.values), len(second.values)

    @property
    def title(self) -> str:
        """Policy and scene."""
        return f"{self.entry.label} on {self.entry.terrain}"

    def rows(self) -> list[Row]:
        """Return a flat row for each point, from the lowest values on."""
        first, second = self.axes
        outcomes = sorted({name for point in self.points.values() for name in point.outcomes})
        return [
            {
                first.name: first.values[i],
                second.name: second.values[j],
                "episodes": point.episodes,
                "success_rate": point.success,
                "pitch_variation_100hz": point.pitch_variation,
                **{name: point.outcomes.get(name, 0) for name in outcomes},
            }
            for (i, j), point in sorted(self.points.items(), key=lambda item: item[0][::-1])
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        numbers = self.entry.config.eval
        return {
            "controller": self.entry.label,
            "terrain": self.entry.terrain,
            **({"interrupted": True} if self.interrupted else {}),
            "axes": [
                {"name": a.name, "settings": list(a.keys), "unit": a.unit, "values": list(a.values)}
                for a in self.axes
            ],
            "episodes_per_cell": numbers.episodes,
            "seed": numbers.seed,
            "cells_played": self.played,
            "conditions": self.entry.conditions.to_dict(),
            "cells": self.rows(),
        }


def capability_map(entry: Entry, axes: tuple[Axis, Axis], player: Player) -> CapabilityMap:
    """Return the map of a policy; ``entry.config.eval`` has the episodes of a point.

    A point's episodes are those of an evaluation with the values of the axes as overrides; one that
    is not possible raises before any episode. Once a stop is asked for, the map has the finished
    points alone.
    """
    size = len(axes[0].values), len(axes[1].values)
    every = product(range(size[0]), range(size[1]))
    configs = {point: grid_config(entry.config, axes, point) for point in every}
    failures: dict[Index, Row] = {}
    entry.source.build(configs[0, 0])  # raises for a wrong layout or robot

    def play(points: Sequence[Index], label: str) -> Iterator[tuple[Index, Episodes]]:
        requests = [(configs[point], entry.source) for point in points]
        for point, episodes in zip(points, player.play_many(requests, label), strict=False):
            if failed := episodes.failed:
                failures[point] = failed[0]
            yield point, episodes

    points, complete = _sample(size, play)
    if not points:
        raise InterruptedRunError("interrupted: no point of the map is finished")
    return CapabilityMap(entry, axes, points, interrupted=not complete, failures=failures)


def notes(entry: Entry, axes: tuple[Axis, Axis]) -> Iterator[str]:
    """Yield what the controller does otherwise than its settings name, in a part of the map."""
    first, second = (range(len(axis.values)) for axis in axes)
    border = [*((i, 0) for i in first), *((0, j) for j in second)]
    source = entry.source
    found = {n: at for at in border for n in source.notes(grid_config(entry.config, axes, at))}
    known = set(source.notes(entry.config))
    new = [(note, at) for note, at in found.items() if note not in known]
    if new:
        note, at = new[0]
        where = ", ".join(f"{a.name}={a.values[i]:g}" for a, i in zip(axes, at, strict=True))
        more = f", and {len(new) - 1} like it at other points" if len(new) > 1 else ""
        yield f"in a part of the map, such as {where}: {note}{more}"


def _sample(size: Index, play: Play) -> tuple[dict[Index, GridPoint], bool]:
    """Return the points of a grid of ``size`` values along each axis, and whether it is complete.

    The grid is divided into blocks, whose corners are played. A block is divided further unless
    the success of all its played points is within the tolerance of 1, or of all within it of 0. The
    other points are interpolated between the corners of their block. If the playing was stopped,
    only points that were played are returned.
    """
    points: dict[Index, GridPoint] = {}
    blocks: list[Block] = list(product(_coarse(size[0]), _coarse(size[1])))
    while True:
        missing = sorted({c for block in blocks for c in _corners(block) if c not in points})
        label = f"map, {len(points)} of at most {size[0] * size[1]} points played"
        points |= {index: GridPoint.of(episodes) for index, episodes in play(missing, label)}
        if any(index not in points for index in missing):
            return points, False
        divided = [b for b in blocks if _divides(b, points)]
        if not divided:
            return points | _interpolated(blocks, points), True
        parts = [part for columns, rows in divided for part in product(_half(columns), _half(rows))]
        blocks = [b for b in blocks if b not in divided] + parts


def _coarse(count: int) -> list[Index]:
    """Return the intervals of the coarse grid along an axis of ``count`` values."""
    step = 1
    while 2 * step * _COARSE <= count - 1:
        step *= 2
    return list(pairwise([*range(0, count - 1, step), count - 1]))


def _half(interval: Index) -> list[Index]:
    """Return the halves of an interval, or the interval if nothing lies between its ends."""
    first, last = interval
    middle = (first + last) // 2
    return [(first, middle), (middle, last)] if last - first > 1 else [interval]


def _corners(block: Block) -> list[Index]:
    """Return the lower left, lower right, upper left and upper right point."""
    columns, rows = block
    return [(i, j) for j in rows for i in columns]


def _divides(block: Block, points: Mapping[Index, GridPoint]) -> bool:
    """Return whether success changes within a block, where neighbours may have played points."""
    (left, right), (low, high) = block
    found = [p.success for (i, j), p in points.items() if left <= i <= right and low <= j <= high]
    changes = not (min(found) >= 1 - _TOLERANCE or max(found) <= _TOLERANCE)
    return changes and (right - left > 1 or high - low > 1)


def _interpolated(
    blocks: Sequence[Block], points: Mapping[Index, GridPoint]
) -> dict[Index, GridPoint]:
    """Return the points that were not played, each linear between the corners of its block."""
    found = {}
    for block in blocks:
        (left, right), (low, high) = block
        corners = [points[corner] for corner in _corners(block)]
        for i, j in product(range(left, right + 1), range(low, high + 1)):
            if (i, j) not in points:
                x, y = (i - left) / (right - left), (j - low) / (high - low)
                weights = [(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y]
                pairs = list(zip(corners, weights, strict=True))
                success = sum(point.success * weight for point, weight in pairs)
                near = [(c.pitch_variation, weight) for c, weight in pairs if weight > 0]
                known = [value * weight for value, weight in near if value is not None]
                variation = sum(known) if len(known) == len(near) else None
                found[i, j] = GridPoint(0, success, variation)
    return found


def write(folder: Path, found: CapabilityMap) -> None:
    """Write all files of a map into an existing folder.

    Failures nearest to the boundary come first: at points whose success is closest to one half.
    """
    from flipperctl.figures.figure import WIDTH, save
    from flipperctl.figures.map import map_figure

    document = found.to_dict()
    write_json(folder / "map.json", document)
    write_csv(folder / "map.csv", found.rows())
    about = f"{found.title}, conditions {found.entry.conditions.label}"
    save(map_figure(document, width=WIDTH), folder / "map.png", about)
    points = sorted(found.failures, key=lambda at: (abs(found.points[at].success - 0.5), at))
    for i, j in points[:MOST_FAILURES]:
        row, config = found.failures[i, j], grid_config(found.entry.config, found.axes, (i, j))
        record = EpisodeRecord.of(config, found.entry.source, row)
        name = f"failure_map_{i}_{j}_{row['episode']}.json"
        write_json(folder / name, record.model_dump(mode="json"))


def lines(found: CapabilityMap) -> Iterator[str]:
    """Yield the success of each point as text; a dot marks those that are interpolated."""
    first, second = found.axes
    columns, rows = found.size
    heads, below = _heads(second.values), _heads(first.values)
    indent, width = max(map(len, heads)), max(4, 1 + max(map(len, below)))
    texts = {
        at: f"{'' if point.episodes else '·'}{100 * point.success:.0f}"
        for at, point in found.points.items()
    }
    yield f"{found.title}: success [%]"
    yield f"columns: {first.label}; rows: {second.label}"
    for j in reversed(range(rows)):
        row = "".join(f"{texts.get((i, j), '–'):>{width}}" for i in range(columns))
        yield f"{heads[j]:>{indent}} {row}"
    yield f"{'':{indent}} " + "".join(f"{value:>{width}}" for value in below)
    yield (
        f"{found.played} of {columns * rows} points played, {found.entry.config.eval.episodes} "
        "episodes each; dots: interpolated"
    )
    if words := found.entry.conditions.line([key for axis in found.axes for key in axis.keys]):
        yield f"conditions {found.entry.conditions.name}, but for the axes: {words}"


def _heads(values: Sequence[float]) -> list[str]:
    """Return the values with the fewest digits, two or more, that tell them apart."""
    every = ([f"{value:.{n}g}" for value in values] for n in range(2, DIGITS))
    apart = (heads for heads in every if len(set(heads)) == len(heads))
    return next(apart, [f"{value:.{DIGITS}g}" for value in values])
