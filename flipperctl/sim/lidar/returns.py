"""What a LiDAR measures of true distances: errors, mixed returns at edges, losses.

In: the true distances of a turn. Out: the measured ones, and which of them return.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray
from flipperctl.sim.lidar.pattern import RINGS, directions

_STEEP = math.tan(math.radians(70.0))
"""Neighbouring rays meet two surfaces if the slope between them is above this, and differs by more
from the slope on the other side: on one surface, both are equal [-]."""


@dataclass(frozen=True)
class RangeErrors:
    """Errors of the measured distances."""

    noise: float
    """Standard deviation [m]."""
    bias: float
    """Constant error of the episode [m]."""
    resolution: float
    """Step of the distances; 0: none [m]."""
    dropout: float
    """Fraction of the returns that are lost [-]."""
    mixed: float = 0.0
    """Fraction of the returns at depth discontinuities that lie between the two surfaces [-]."""
    mixed_gap: float = 1.0
    """Farther surfaces do not mix [m]."""
    grazing: float = 2.0
    """Angle of incidence at which half of the returns are lost [rad]."""
    grazing_width: float = 0.1
    """Range of angles in which the lost fraction rises from 0 to 1 [rad]."""


class _Neighbours(NamedTuple):
    """The neighbouring rays on one side of each ray, as (A, RINGS) arrays."""

    slope: FloatArray
    """Tangent of the angle of incidence on a plane through both hits, positive if the neighbour is
    farther; NaN without a hit [-]."""
    gap: FloatArray
    """By how much the neighbour's distance is larger; NaN without a hit [m]."""


class Returns:
    """Turns true distances into measured ones."""

    def __init__(self, errors: RangeErrors, azimuths: int) -> None:
        """``azimuths``: number of the rays of each ring in a turn."""
        self._errors, self._azimuths = errors, azimuths
        rays = directions(azimuths).reshape(azimuths, RINGS, 3)
        self._along = _angle(rays[0], rays[1])  # (RINGS,) [rad]
        self._across = _angle(rays[0, :-1], rays[0, 1:])  # (RINGS - 1,) [rad]
        last = errors.grazing - errors.grazing_width / 2
        self._grazes = last < math.pi / 2

    def measured(
        self, true: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the measured distances of a turn [m] and whether they return, each (R,).

        ``true`` (R,) distances are infinite without a hit; all rings of an azimuth follow each
        other.
        """
        errors, count = self._errors, len(true)
        # Drawn for all rays, so that no draw depends on what the others met.
        noise, returned = rng.standard_normal(count), rng.random(count) >= errors.dropout
        if errors.mixed or self._grazes:
            sides = self._sides(true.reshape(self._azimuths, RINGS))
            mixes, between, grazes = rng.random((3, count))
            gap = np.zeros(count)
            (mixing,) = np.nonzero(mixes < errors.mixed)
            gap[mixing] = _edges([_at(side, mixing) for side in sides], errors.mixed_gap)
            returned &= grazes >= self._lost(sides)
            true = true + between * gap
        found = true + errors.bias + errors.noise * noise
        if errors.resolution:
            found = errors.resolution * np.round(found / errors.resolution)
        return found, returned

    def _lost(self, sides: list[_Neighbours]) -> FloatArray:
        """Return the fraction of the returns that are lost by grazing incidence, (R,)."""
        errors = self._errors
        lost = np.zeros(sides[0].slope.size)
        if not self._grazes:
            return lost
        tangent = np.hypot(*(_flatter(*sides[i : i + 2]) for i in (0, 2))).ravel()
        none_below = errors.grazing - errors.grazing_width / 2 - 1e-9
        (grazing,) = np.nonzero(tangent > math.tan(max(0.0, none_below)))
        incidence = np.arctan(tangent[grazing])
        lost[grazing] = np.clip(0.5 + (incidence - errors.grazing) / errors.grazing_width, 0.0, 1.0)
        return lost

    def _sides(self, true: FloatArray) -> list[_Neighbours]:
        """Return the neighbours on both sides along the rings, then across them."""
        none = np.full((self._azimuths, 1), np.inf)
        above = np.concatenate([true[:, 1:], none], axis=1)
        below = np.concatenate([none, true[:, :-1]], axis=1)
        across = np.append(self._across, self._across[-1])
        return [
            _compared(true, np.roll(true, -1, axis=0), self._along),
            _compared(true, np.roll(true, 1, axis=0), self._along),
            _compared(true, above, across),
            _compared(true, below, across),
        ]


def _at(side: _Neighbours, chosen: NDArray[np.int64]) -> _Neighbours:
    """Return the neighbours of the ``chosen`` rays alone, as (C,) arrays."""
    return _Neighbours(side.slope.ravel()[chosen], side.gap.ravel()[chosen])


def _angle(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the angles between unit vectors (V, 3), (V,) [rad]."""
    return np.asarray(2 * np.arcsin(np.linalg.norm(one - other, axis=-1) / 2))


def _compared(true: FloatArray, other: FloatArray, angle: FloatArray) -> _Neighbours:
    """Return how the distances ``other`` of rays at an ``angle`` [rad] beside compare to ``true``.

    On a plane, the inverse of the distance is proportional to the cosine of the angle of incidence,
    from which the tangent of that angle follows.
    """
    with np.errstate(invalid="ignore"):
        both = np.isfinite(true) & np.isfinite(other)
        slope = np.where(both, (np.cos(angle) - true / other) / np.sin(angle), np.nan)
        return _Neighbours(slope, np.where(both, other - true, np.nan))


def _flatter(one: _Neighbours, other: _Neighbours) -> FloatArray:
    """Return the smaller slope of both sides; an edge on one side does not count."""
    found = np.fmin(np.abs(one.slope), np.abs(other.slope))
    return np.asarray(np.where(np.isnan(found), 0.0, found))


def _edges(sides: list[_Neighbours], largest: float) -> FloatArray:
    """Return the gap to the nearest surface behind or before an edge beside each ray, else 0 [m].

    Gaps above ``largest`` do not count.
    """
    nearest = np.full_like(sides[0].gap, np.inf)
    for i, (slope, gap) in enumerate(sides):
        bend = np.abs(slope + sides[i ^ 1].slope)  # on a plane, the slopes are opposite
        edge = (np.abs(slope) > _STEEP) & (bend > _STEEP) & (np.abs(gap) <= largest)
        nearest = np.where(edge & (np.abs(gap) < np.abs(nearest)), gap, nearest)
    return np.asarray(np.where(np.isinf(nearest), 0.0, nearest))
