"""A line over recorded ground with heights along it, and the ground beside it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from flipperctl.api import FloatArray, Surface


@dataclass(frozen=True)
class Line:
    """The line over the ground along which a profile is sampled."""

    start: tuple[float, float]
    """First point, (x, y) [m]."""
    end: tuple[float, float]
    """Last point, (x, y) [m]."""
    spacing: float
    """Distance between two heights [m]; the last distance may be shorter."""
    stretch: FloatArray = field(default_factory=lambda: np.eye(2))
    """Turns a step in (x, y) into one of its length on the ground, (2, 2) [-].

    It differs from the unit matrix if the frame is a projection that stretches the ground.
    """

    @property
    def length(self) -> float:
        """Distance from start to end [m]."""
        return float(np.hypot(*(self.stretch @ np.subtract(self.end, self.start))))

    @property
    def direction(self) -> FloatArray:
        """Step in (x, y) towards the end for each metre of ground, (2,)."""
        return np.subtract(self.end, self.start) / self.length

    @property
    def left(self) -> FloatArray:
        """Step in (x, y) to the left of the line for each metre of ground, (2,)."""
        ahead = self.stretch @ self.direction
        return np.asarray(np.linalg.solve(self.stretch, np.array([-ahead[1], ahead[0]])))

    @property
    def distances(self) -> FloatArray:
        """Distances of the heights from the start, both ends included, (D,) [m]."""
        inner = np.arange(0.0, self.length - 1e-9, self.spacing)
        return np.append(inner, self.length)

    @property
    def points(self) -> FloatArray:
        """Positions of the heights, (D, 2) in (x, y) [m]."""
        return np.asarray(self.start) + self.distances[:, None] * self.direction

    def profile(
        self, heights: FloatArray, largest_gap: float, unknown: str = "no height is known"
    ) -> FloatArray:
        """Return distance and height of each point, (D, 2) [m], from heights (D,) [m].

        Unknown heights are NaN and are interpolated linearly, or continued to the line's ends.
        ``unknown`` begins the text of the error.

        Raises:
            ValueError: heights are unknown over more than ``largest_gap`` [m].
        """
        if not np.isfinite(heights).any():
            raise ValueError(f"{unknown} along the line from {self.start} to {self.end}")
        for low, high in self._gaps(heights, largest_gap):
            raise ValueError(
                f"{unknown} from {low:.2f} to {high:.2f} m along the line; "
                f"the largest gap that is bridged is {largest_gap:g} m"
            )
        return np.column_stack([self.distances, self.bridged(heights, largest_gap)])

    def bridged(self, heights: FloatArray, largest_gap: float) -> FloatArray:
        """Return heights (D,) [m] with gaps up to ``largest_gap`` [m] filled; others stay NaN."""
        known = np.isfinite(heights)
        if not known.any():
            return heights
        distances = self.distances
        filled = np.interp(distances, distances[known], heights[known])
        for low, high in self._gaps(heights, largest_gap):
            filled[~known & (distances >= low) & (distances <= high)] = np.nan
        return filled

    def _gaps(self, heights: FloatArray, largest_gap: float) -> Iterator[tuple[float, float]]:
        """Yield the distances between which heights are unknown over more than the largest gap."""
        at = self.distances[np.isfinite(heights)]
        for low, high in zip(np.append(0.0, at), np.append(at, self.length), strict=True):
            if high - low > max(largest_gap, self.spacing + 1e-9):
                yield low, high


class RecordedSurface(Surface):
    """Heights from a file, read once, since each episode asks for the same ones."""

    def __init__(self, x: FloatArray, read: Callable[[FloatArray], FloatArray]) -> None:
        """Read heights (X, Y) at ``x`` (X,) and the asked y (Y,) by ``read`` [m]."""
        self._x, self._read = x, read
        self._last: tuple[FloatArray, FloatArray] | None = None

    @property
    def x(self) -> FloatArray:
        """Places along the line, ascending, (X,) [m]."""
        return self._x

    def heights(self, y: FloatArray) -> FloatArray:
        """Return the heights at each of ``x`` and ``y`` (Y,), (X, Y) [m]; NaN where unknown."""
        if self._last is None or not np.array_equal(self._last[0], y):
            self._last = y.copy(), self._read(y)
        return self._last[1]
