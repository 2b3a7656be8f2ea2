"""The LiDAR of ``perception=lidar`` in simulation: a turn of rays, cast in parts while it moves.

In: the true state, rays in the engine's world. Out: a ``Scan`` of each turn, whose points carry
their ages, with errors, mixed returns at edges and losses. The chassis is met by the same rays
always, and the flippers by few, so neither is computed for all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Instrument, RayWorld, RobotState
from flipperctl.core.lidar.body import Body, Mount, mounting
from flipperctl.core.lidar.messages import Scan
from flipperctl.sim.lidar.instruments import to_world

RINGS = 32
"""Number of lasers, each of which draws a ring [-]."""
_LOWEST, _SPACING = np.radians(2.3125), np.radians(2.8125)
"""Angle of the lowest ring above the base, and between two rings [rad].

By the table of channels in the RS-Bpearl's user manual (2.0.1), from 2.3125° to 89.5°.
"""


def directions(azimuths: int) -> FloatArray:
    """Return a ray for each of ``azimuths`` and ``RINGS``, (R, 3)."""
    above = _LOWEST + _SPACING * np.arange(RINGS)
    around = 2 * np.pi / azimuths * np.arange(azimuths)
    height, azimuth = (angles.ravel() for angles in np.meshgrid(above, around))
    flat = np.cos(height)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(height)])


class OwnHits:
    """The distances from one place on the robot to its own body along given rays."""

    def __init__(self, body: Body, origin: FloatArray, rays: FloatArray) -> None:
        """``origin`` (3,) [m] and the unit vectors ``rays`` (R, 3) are in frame R."""
        self._body, self._origin = body, origin
        self._to_chassis = body.distances_to_chassis(origin, rays)
        self._near = np.flatnonzero(body.may_hit_flippers(origin, rays))
        self._rays = rays[self._near]

    def distances(self, front: float, rear: float) -> FloatArray:
        """Return the distance to the robot along each ray, (R,), infinite if it misses it [m]."""
        found = self._to_chassis.copy()
        flippers = self._body.distances_to_flippers(self._origin, self._rays, front, rear)
        found[self._near] = np.minimum(found[self._near], flippers)
        return found


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


SCAN_PERIOD = 0.1
"""Time of a turn, at 10 turns a second [s]."""


class Scanner(Instrument):
    """Casts the rays of a LiDAR in the engine's world."""

    def __init__(
        self,
        azimuths: int,
        reach: float,
        errors: RangeErrors,
        mount: Mount,
        body: Body,
        world: RayWorld,
        parts: int = 1,
    ) -> None:
        """``reach``: farthest distance that returns [m]; ``body`` casts shadows.

        A turn is cast in so many ``parts``, each from the pose of its instant.
        """
        self.period = SCAN_PERIOD / parts
        self._reach, self._near = reach, mount.near
        self._world = world
        self._place = np.array([mount.x, 0.0, mount.z])
        self._rays = directions(azimuths)  # all rings of the first azimuth, then of the next one
        self._in_robot = self._rays @ mounting(mount.axis).T
        self._returns = Returns(errors, azimuths)
        borders = [RINGS * (azimuths * part // parts) for part in range(parts + 1)]
        self._parts = [slice(*ends) for ends in pairwise(borders)]
        self._own = [OwnHits(body, self._place, self._in_robot[part]) for part in self._parts]
        self._cast: tuple[tuple[float, FloatArray], ...] | None = None
        """Time [s] and true distances [m] of each part of the turn so far; None: before the first
        one, which is that of a robot that stands still."""

    def measure(self, state: RobotState, rng: np.random.Generator) -> Scan | None:
        """Return the points of the turn that this instant completes; None: it goes on."""
        if self._cast is None:
            self._cast = ()
            return self._scan(self._distances(state, slice(None), self._own), None, rng)
        number = len(self._cast)
        found = self._distances(state, self._parts[number], self._own[number : number + 1])
        self._cast = (*self._cast, (state.time, found))
        if len(self._cast) < len(self._parts):
            return None
        times, distances = zip(*self._cast, strict=True)
        self._cast = ()
        ages = np.repeat(state.time - np.array(times), [len(found) for found in distances])
        return self._scan(np.concatenate(distances), ages if len(times) > 1 else None, rng)

    def _distances(self, state: RobotState, part: slice, own: Sequence[OwnHits]) -> FloatArray:
        """Return the true distances along the rays of a part, infinite without a hit, (R,) [m].

        ``own``: what hits the robot itself of these rays, in their order.
        """
        turn = to_world(state)
        x, z = state.position
        origin = np.array([x, state.side, z]) + turn @ self._place
        ground = self._world.cast_rays(origin, self._in_robot[part] @ turn.T, self._reach)
        hits = [one.distances(state.front, state.rear) for one in own]
        return np.minimum(ground, np.concatenate(hits))

    def _scan(self, true: FloatArray, ages: FloatArray | None, rng: np.random.Generator) -> Scan:
        measured, returned = self._returns.measured(true, rng)
        returned &= (true >= self._near) & (true <= self._reach)
        points = self._rays.compress(returned, axis=0) * measured[returned, None]
        return Scan(points, None if ages is None else ages[returned])

    def save(self) -> Any:
        """Return a snapshot of the turn so far."""
        return self._cast

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
        self._cast = saved
