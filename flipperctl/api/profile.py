"""The ground of an episode: its profile in the robot's side plane, and the surface beside it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flipperctl.core import FloatArray


class Surface(ABC):
    """Heights beside the line of a profile, which is the surface's cut at y = 0.

    Frame: world, x forward along the line, y to its left, z up. Heights are read on request;
    engines of the side plane request none.
    """

    @property
    @abstractmethod
    def x(self) -> FloatArray:
        """Ascending positions along the line, from the first point to the last, (X,) [m]."""

    @abstractmethod
    def heights(self, y: FloatArray) -> FloatArray:
        """Return the heights at each of ``x`` and ``y`` (Y,), (X, Y) [m]; NaN where unknown.

        Raises:
            ValueError: the ground cannot be read.
        """


class MirroredSurface(Surface):
    """A surface that is driven from its end to its start."""

    def __init__(self, surface: Surface, end: tuple[float, float]) -> None:
        """Reverse ``surface`` about the line's last point, ``end`` (x, z) [m], the new origin."""
        self._surface, self._end = surface, end

    @property
    def x(self) -> FloatArray:
        """Positions along the line, ascending, (X,) [m]."""
        return self._end[0] - self._surface.x[::-1]

    def heights(self, y: FloatArray) -> FloatArray:
        """Return the heights at each of ``x`` and ``y`` (Y,), (X, Y) [m]; NaN where unknown."""
        return self._surface.heights(-y[::-1])[::-1, ::-1] - self._end[1]


@dataclass(frozen=True)
class Profile:
    """The obstacle in the robot's side plane, from its first edge to its last.

    ``points`` is (V, 2) [m]: x never decreases, two points of equal x are a vertical face.
    The ground is level before the first point and past the last. ``label`` names the generated
    terrain in tables; if it is empty, they show the terrain's own name. ``surface`` is the ground
    beside the line, if it is known; without it, the profile is extruded to both sides. ``drawn``
    are the numbers that the terrain drew, by name, such as ``steps``; results can be shown by them.
    ``run_up`` and ``run_out`` replace the settings of the section ``episode`` on this ground [m].
    Below 0 the robot starts past the first edge, at the nearest place where it can stand, or
    finishes before the last.

    Raises:
        ValueError: if the points are empty, not finite, not (V, 2), or x decreases, or if run_up
            or run_out is not finite.
    """

    spacing: ClassVar[float] = 0.02
    """Distance of the points of ``cloud`` along the outline [m]."""

    points: FloatArray
    label: str = ""
    surface: Surface | None = None
    drawn: Mapping[str, float] = field(default_factory=dict)
    run_up: float | None = None
    run_out: float | None = None

    def __init__(
        self,
        points: ArrayLike | Sequence[tuple[float, float]],
        label: str = "",
        surface: Surface | None = None,
        drawn: Mapping[str, float] | None = None,
        run_up: float | None = None,
        run_out: float | None = None,
    ) -> None:
        # A copy, which becomes read-only: worlds and transitions share the profile.
        try:
            array = np.array(points, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ValueError(f"a profile is (V, 2) points of x and z: {error}") from error
        if array.size == 0:
            raise ValueError("a profile needs at least one point; it is empty")
        if array.ndim != 2 or array.shape[1] != 2:
            raise ValueError(f"a profile is (V, 2) points of x and z; the shape is {array.shape}")
        if not np.isfinite(array).all():
            bad = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
            raise ValueError(f"profile point {bad} is not finite: {tuple(array[bad].tolist())}")
        drops = np.flatnonzero(np.diff(array[:, 0]) < 0)
        if drops.size:
            i = int(drops[0])
            raise ValueError(
                f"x decreases from {array[i, 0]:g} to {array[i + 1, 0]:g} m "
                f"between profile points {i} and {i + 1}; it must never decrease"
            )
        for name, distance in (("run_up", run_up), ("run_out", run_out)):
            if distance is not None and not math.isfinite(distance):
                raise ValueError(f"a profile's {name} is a finite number; it is {distance}")
            object.__setattr__(self, name, None if distance is None else float(distance))
        # The dataclass is frozen, its own constructor included.
        array.setflags(write=False)
        object.__setattr__(self, "points", array)
        object.__setattr__(self, "label", label)
        object.__setattr__(self, "surface", surface)
        object.__setattr__(self, "drawn", {} if drawn is None else drawn)

    @cached_property
    def start(self) -> float:
        """World x of the first edge [m]."""
        return float(self.points[0, 0])

    @cached_property
    def end(self) -> float:
        """World x of the last edge [m]."""
        return float(self.points[-1, 0])

    # Heights of the ground.
    def heights(self, x: FloatArray) -> FloatArray:
        """Return ``height`` at each of x (M,) [m], (M,) [m]."""
        at, up = self.points.T
        # Linear between neighbours, level before the first point and past the last.
        right = np.searchsorted(at, x, side="right")
        i, j = np.maximum(right - 1, 0), np.minimum(right, len(at) - 1)
        between = (right > 0) & (right < len(at))
        rise, zero = (up[j] - up[i]) * (x - at[i]), np.zeros(len(x))
        heights: FloatArray = up[i] + np.divide(rise, at[j] - at[i], out=zero, where=between)
        for index in np.flatnonzero(np.searchsorted(at, x) < right):  # on a vertex, perhaps a face
            heights[index] = self.height(float(x[index]))
        return heights

    def extended(self, before: float, after: float) -> FloatArray:
        """Return the polyline with level ground of these lengths added, (V + 2, 2) [m].

        Raises:
            ValueError: a length is below 0.
        """
        if before < 0 or after < 0:
            text = f"level ground of {min(before, after):g} m cannot be added"
            raise ValueError(f"{text}; 0 m or more is allowed")
        first, last = self.points[0], self.points[-1]
        return np.vstack([[first[0] - before, first[1]], self.points, [last[0] + after, last[1]]])

    def height(self, x: float) -> float:
        """Return the height of the ground at x, at a vertical face that of its top [m]."""
        points = self.points
        right = int(np.searchsorted(points[:, 0], x, side="right"))
        left = int(np.searchsorted(points[:, 0], x, side="left"))
        # Points of equal x are a vertical face, whose top counts.
        if left < right:
            return float(points[left:right, 1].max())
        if right == 0 or right == len(points):
            return float(points[0 if right == 0 else -1, 1])
        (x0, z0), (x1, z1) = points[right - 1], points[right]
        return float(z0 + (z1 - z0) * (x - x0) / (x1 - x0))

    # Points of the ground, as sensors and rules take them.
    def sample(self, spacing: float, margin: float) -> FloatArray:
        """Return points along the outline, vertical faces included, (P, 2) in world [m].

        The points are ``spacing`` [m] apart and their x never decreases; ``margin`` [m] of level
        ground is added on both sides.
        """
        line = self.extended(margin, margin)
        lengths = np.hypot(*np.diff(line, axis=0).T)  # (V + 1,) [m]
        along = np.concatenate([[0.0], np.cumsum(lengths)])
        at = np.arange(0.0, along[-1], spacing)
        return np.column_stack([np.interp(at, along, line[:, 0]), np.interp(at, along, line[:, 1])])

    @cached_property
    def relief(self) -> tuple[float, float]:
        """Middle between the lowest and the highest point, and half their distance [m]."""
        low, high = float(self.points[:, 1].min()), float(self.points[:, 1].max())
        return (low + high) / 2, (high - low) / 2

    @cached_property
    def cloud(self) -> FloatArray:
        """Points every 0.02 m of the outline with 3 m of level ground on both sides, (P, 2) [m]."""
        return self.sample(self.spacing, 3.0)

    def around(self, x: float, reach: float, *, far: bool = False) -> FloatArray:
        """Return points of the ground within ``reach`` [m] of x, (P', 2) in world [m].

        ``far``: the level ground on both sides has no end, for a robot anywhere; else it ends after
        3 m, as in ``cloud``.
        """
        begin, end = x - reach, x + reach
        along = self.cloud[:, 0].data  # a memoryview, which is faster for bisect
        first, last = bisect_left(along, begin), bisect_left(along, end)
        if not far or (along[0] <= begin and end <= along[-1]):
            return self.cloud[first:last]
        # Endless level ground continues the cloud at its spacing.
        index = np.arange(*self.indices(np.array([begin, end])))
        inside = np.clip(index, 0, len(along) - 1)
        points = self.cloud[inside]
        points[:, 0] += (index - inside) * self.spacing
        return points

    def around_each(
        self, x: FloatArray | float, reach: FloatArray | float, *, far: bool = False
    ) -> FloatArray:
        """Return x and z of ``around`` of each of M positions, (2, M, P) in world [m].

        ``x`` is (M,) and ``reach`` (M,) or one number [m]. Rows of fewer points end in NaN. If
        ``x`` is a number, the points are (2, P).
        """
        if not getattr(x, "ndim", 0):  # faster than numpy's function
            return self.around(float(x), float(reach), far=far).T
        # Each row is a slice of the cloud, padded with the index of a NaN at its end.
        along = self.cloud[:, 0]
        begin, end = np.subtract(x, reach), np.add(x, reach)
        indices = self.indices if far else along.searchsorted
        first, last = indices(begin), indices(end)
        beyond = far and bool((first < 0).any() or (last > len(along)).any())
        counts = np.maximum(0, last - first)
        step = np.arange(counts.max(initial=0))
        index, valid = first[:, None] + step, step < counts[:, None]
        inside = np.where(valid, np.clip(index, 0, len(along) - 1) if beyond else index, len(along))
        points: FloatArray = self._columns.take(inside, axis=1)
        if beyond:
            points[0] += (index - inside) * self.spacing
        return points

    def indices(self, x: FloatArray) -> NDArray[np.intp]:
        """Return the index in ``cloud`` of the first point that is not before each x, (M,).

        Endless level ground continues the cloud at its ``spacing``, with indices below 0 and from P
        on.
        """
        along = self.cloud[:, 0]
        index = along.searchsorted(x)
        for end, beyond in ((0, x < along[0]), (len(along) - 1, x > along[-1])):
            if beyond.any():
                # Steps to the nearest point, and to the next one if that is before x
                steps = np.rint((x - along[end]) / self.spacing).astype(np.intp)
                steps += along[end] + steps * self.spacing < x
                index = np.where(beyond, end + steps, index)
        return index

    @cached_property
    def _columns(self) -> FloatArray:
        """X and z of ``cloud``, and NaN at their end, (2, P + 1) [m]."""
        return np.vstack([self.cloud, [math.nan, math.nan]]).T.copy()
