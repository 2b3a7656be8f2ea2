"""The LiDAR of ``perception=lidar`` in simulation: a turn of rays, cast in parts while it moves.

In: the true state, rays in the engine's world. Out: a ``Scan`` of each turn, whose points carry
their ages.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Instrument, RayWorld, RobotState
from flipperctl.core.lidar.body import Body
from flipperctl.core.lidar.messages import Scan
from flipperctl.core.lidar.mount import Mount
from flipperctl.core.lidar.rotations import mounting
from flipperctl.sim.lidar.frames import to_world
from flipperctl.sim.lidar.own import OwnHits
from flipperctl.sim.lidar.pattern import RINGS, directions
from flipperctl.sim.lidar.returns import RangeErrors, Returns

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
