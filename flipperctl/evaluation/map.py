"""A map of capability: where in the plane of two settings a policy reaches the finish.

In: a scene, axes such as ``terrain.height=0.1:0.6,sim.friction=0.4:1.0``, and a player of episodes.
Out: success and pitch variation of every point of the grid. A coarse grid is played first, and then
the points where success changes; points between equal ones are interpolated and marked as such.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product
from typing import Any

import numpy as np

from flipperctl.config import EvalConfig, with_overrides
from flipperctl.config.defaults import refuse_ineffective
from flipperctl.config.describe import Setting, settings
from flipperctl.errors import ConfigError, InterruptedRunError, RequestError
from flipperctl.evaluation.plan import Entry
from flipperctl.evaluation.play import Player
from flipperctl.evaluation.rows import Episodes, Row
from flipperctl.text.messages import close_match

Index = tuple[int, int]
"""Indices of a grid point: along the horizontal and along the vertical axis."""
EXAMPLE = "terrain.height=0.1:0.6,sim.friction=0.4:1.0"
_VALUES, _MOST = 20, 100
"""Number of values of an axis without a number of its own, and the largest number [-]."""
DIGITS = 6  # digits that the values of an axis are rounded to [-], so that a point can be typed
_SECTIONS = ("terrain", "robot", "sim", "perception", "episode")
_BOUND = re.compile(r"([≥>≤<]) ([-+.\de]+)")
Play = Callable[[Sequence[Index], str], Iterator[tuple[Index, Episodes]]]
"""Plays the episodes of grid points, shown under a label, and yields them as they are finished;
fewer points if it was stopped."""
Block = tuple[Index, Index]
"""A rectangle of points: the first and last index along the horizontal and the vertical axis."""
EPISODES = 10  # episodes of a grid point, unless the user chooses another number [-]
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

    A point has the episodes of an evaluation with the values of the axes as overrides. An
    impossible point raises before any episode. Once a stop is asked for, the map has the finished
    points alone.
    """
    size = len(axes[0].values), len(axes[1].values)
    grid = product(range(size[0]), range(size[1]))
    # All points are composed first, so that an impossible one ends the map before it begins.
    configs = {point: grid_config(entry.config, axes, point) for point in grid}
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
    point_of = {n: at for at in border for n in source.notes(grid_config(entry.config, axes, at))}
    known = set(source.notes(entry.config))
    new = [(note, at) for note, at in point_of.items() if note not in known]
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
        # Blocks in which success changes are divided; the others can be interpolated.
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
    rates = [p.success for (i, j), p in points.items() if left <= i <= right and low <= j <= high]
    changes = not (min(rates) >= 1 - _TOLERANCE or max(rates) <= _TOLERANCE)
    return changes and (right - left > 1 or high - low > 1)


def _interpolated(
    blocks: Sequence[Block], points: Mapping[Index, GridPoint]
) -> dict[Index, GridPoint]:
    """Return the points that were not played, each linear between the corners of its block."""
    grid = {}
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
                grid[i, j] = GridPoint(0, success, variation)
    return grid


@dataclass(frozen=True)
class Axis:
    """Settings with one common value, and the values along the axis."""

    name: str
    """The settings as the user named them."""
    keys: tuple[str, ...]
    """Paths of the settings in the configuration."""
    unit: str
    values: tuple[float, ...]
    """At least two values in increasing order, in the unit of the settings."""

    @property
    def label(self) -> str:
        """Name and unit, for figures."""
        return self.name if self.unit in ("", "-") else f"{self.name} [{self.unit}]"


def parse_axes(text: str, config: EvalConfig) -> tuple[Axis, Axis]:
    """Return the horizontal and the vertical axis that ``text``, given with ``--over``, names.

    Each is a setting of the terrain, robot, engine, sensor or episode with a range ``LOW:HIGH`` or
    ``LOW:HIGH:VALUES``, both ends included. A setting that is itself a range has one number at
    each point, and settings joined by ``+`` have a common value. Without a range, an axis leads
    from half to one and a half times the present value, within the bounds of the setting. If the
    value is 0 or null, it leads over the bounds.
    """
    parts = text.split(",")
    if len(parts) != 2:
        raise RequestError(
            f"--over: two settings are allowed, as in --over {EXAMPLE}; got {text!r}"
        )
    known = {
        s.path: s
        for s in settings(config)
        if s.path.partition(".")[0] in _SECTIONS and "[" not in s.path and _is_number(s)
    }
    first, second = (_axis(part.strip(), config, known) for part in parts)
    if both := set(first.keys) & set(second.keys):
        raise ConfigError(f"--over: {min(both)} stands in both axes; two settings are needed")
    return first, second


def _is_number(setting: Setting) -> bool:
    """Return whether a setting is a number, a range of numbers, or null in place of one."""
    value, kind = setting.value, setting.field.type
    if value is None:
        return "float" in kind or "int" in kind
    return "Range" in kind or (isinstance(value, int | float) and not isinstance(value, bool))


def _axis(text: str, config: EvalConfig, known: Mapping[str, Setting]) -> Axis:
    name, _, ends = text.partition("=")
    keys = tuple(key for part in name.split("+") for key in _keys(part, config, known))
    refuse_ineffective(config, {key: f"--over {key}" for key in keys})
    settings = [known[key] for key in keys]
    # Whole numbers stay whole, which may leave fewer values.
    whole = not any(re.search(r"\b(float|Range)\b", s.field.type) for s in settings)
    low, high, count = _typed_range(ends, text) if ends else (*_default_range(settings), _VALUES)
    values = [float(v) for v in np.linspace(low, high, count)]
    rounded = [round(v) if whole else float(f"{v:.{DIGITS}g}") for v in values]
    if len(different := tuple(dict.fromkeys(rounded))) < 2:
        raise RequestError(
            f"--over {text}: two different values are needed, "
            f"{'in whole numbers' if whole else 'in six digits'}; got {different[0]:g} alone"
        )
    return Axis(name, keys, settings[0].field.unit, different)


def _keys(name: str, config: EvalConfig, known: Mapping[str, Setting]) -> tuple[str, ...]:
    """Return the paths that a name stands for."""
    if name in known:
        return (name,)
    if any(s.path == name for s in settings(config)):
        raise ConfigError(f"--over {name}: it is no number of ground, robot, engine or sensor")
    there = sorted(path for path in known if path.startswith(f"{name.partition('.')[0]}."))
    allowed = ", ".join(there) or f"settings of {', '.join(_SECTIONS)}"
    raise ConfigError(
        f"--over {name}: there is no such setting{close_match(name, known)}; known: {allowed} "
        "(+ joins settings with one common value, as in terrain.tread+terrain.tread_down)"
    )


def _typed_range(ends: str, text: str) -> tuple[float, float, int]:
    """Return both ends of a typed range, and the number of its values."""
    try:
        low, high, *rest = (float(end) for end in ends.split(":"))
        (count,) = rest or [float(_VALUES)]
    except ValueError as error:
        raise RequestError(f"--over {text}: LOW:HIGH or LOW:HIGH:VALUES is allowed") from error
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise RequestError(f"--over {text}: a range from a lower to a higher number is allowed")
    if not (count.is_integer() and 2 <= count <= _MOST):
        raise RequestError(f"--over {text}: 2 to {_MOST} values are allowed")
    return low, high, int(count)


def _default_range(settings: Sequence[Setting]) -> tuple[float, float]:
    """Return both ends of an axis without a typed range from its settings.

    A bound that is itself not allowed is replaced by a value a twentieth of the range inside it.
    """
    lows, highs = [], []
    for setting in settings:
        # Common bounds of the settings; an excluded bound gives way to a value inside it.
        ends = {sign: float(number) for sign, number in _BOUND.findall(setting.field.bounds)}
        low = ends.get("≥", ends.get(">", -math.inf))
        high = ends.get("≤", ends.get("<", math.inf))
        inside = (high - low) / 20
        lows.append(low + (inside if ">" in ends else 0.0))
        highs.append(high - (inside if "<" in ends else 0.0))
    low, high = max(lows), min(highs)
    # Around the present value, as far as the bounds allow
    if middle := sum(float(np.mean(s.value or 0)) for s in settings) / len(settings):
        near, far = sorted((0.5 * middle, 1.5 * middle))
        low, high = max(low, near), min(high, far)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise RequestError(
            f"--over {settings[0].path}: give a range, as in --over {EXAMPLE}; its bounds and "
            "its present value give none"
        )
    return low, high


def grid_config(config: EvalConfig, axes: tuple[Axis, Axis], at: Index) -> EvalConfig:
    """Return the configuration of the grid point at two indices, one for each axis."""
    pairs = zip(axes, at, strict=True)
    return with_overrides(config, {k: a.values[index] for a, index in pairs for k in a.keys})
