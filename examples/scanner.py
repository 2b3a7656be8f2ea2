"""A sensor of your own that casts rays at 10 Hz and keeps a map of the ground.

Try it: ``flipperctl eval okada perception=scanner --plugins examples/scanner.py``
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from flipperctl import api
from flipperctl.core.sensing import Measured, SensedAngles, SensedGround

MOUNT = 0.25, 0.4  # position of the scanner in frame R: x, z [m]


@api.sensor("scanner")
class Scanner(api.Sensor):
    """Scan the ground from a mast into a map; odometry measures how far the robot has moved."""

    beams: int = Field(120, ge=10, le=1000, description="rays of a scan, in a plane [-]")
    range: float = Field(5.0, ge=1, le=30, description="farthest ground that a ray reaches [m]")
    noise: float = Field(0.0, ge=0, le=0.1, description="standard deviation of a distance [m]")
    slip: float = Field(
        0.0, ge=0, le=0.2, description="fraction of each movement that odometry misses [-]"
    )

    def instruments(self, mounting: api.Mounting) -> Mapping[str, api.Instrument]:
        return {"odometer": Odometer(self.slip), "scanner": Rays(self, mounting.rays)}

    def estimator(self, robot: api.RobotGeometry) -> api.Estimator:
        below = robot.hinge_offset, robot.track_radius
        return Mapper(self.bins, self.bin_width, below)


@dataclass(frozen=True)
class Odometry:
    """The robot's movement since the last measurement, and its angles."""

    moved: NDArray[np.float64]  # (2,) in world [m]
    pitch: float  # [rad]
    front: float  # [rad]
    rear: float  # [rad]


class Odometer(api.Instrument):
    """Measures movements; it stores the position of the last measurement."""

    period = 0.01

    def __init__(self, slip: float) -> None:
        self._slip = slip
        self._last: NDArray[np.float64] | None = None

    def measure(self, state: api.RobotState, rng: np.random.Generator) -> Odometry:
        last, self._last = self._last, state.position
        moved = np.zeros(2) if last is None else (1 - self._slip) * (state.position - last)
        return Odometry(moved, state.pitch, state.front, state.rear)

    def save(self) -> NDArray[np.float64] | None:
        return self._last

    def load(self, saved: NDArray[np.float64] | None) -> None:
        self._last = saved


@dataclass(frozen=True)
class Scan:
    """Distances along rays in frame R."""

    angles: NDArray[np.float64]  # (R,) above the x axis of frame R [rad]
    ranges: NDArray[np.float64]  # (R,) [m], infinite where no ground was hit


class Rays(api.Instrument):
    """Casts rays from the mast in the engine's world."""

    period = 0.1

    def __init__(self, settings: Scanner, world: api.RayWorld) -> None:
        self._angles = np.radians(np.linspace(-170, -5, settings.beams))
        self._settings, self._world = settings, world

    def measure(self, state: api.RobotState, rng: np.random.Generator) -> Scan:
        x, z = state.position + turned(np.array([MOUNT]), state.pitch)[0]
        rays = turned(np.column_stack([np.cos(self._angles), np.sin(self._angles)]), state.pitch)
        rays = np.insert(rays, 1, 0.0, axis=1)  # (R, 3): x, y, z
        ranges = self._world.cast_rays(np.array([x, state.side, z]), rays, self._settings.range)
        ranges = ranges + self._settings.noise * rng.standard_normal(len(ranges))
        return Scan(self._angles, ranges)


class Mapper:
    """The estimator, which runs on a robot too: a map of heights in cells along the path."""

    def __init__(self, bins: int, width: float, below: tuple[float, float]) -> None:
        """``below``: half the length of the ground below the robot, and its depth, at start [m]."""
        self._bins, self._width, self._cell = bins, width, width / 5
        self._place, self._angles = np.zeros(2), (0.0, 0.0, 0.0)  # pitch, front, rear [rad]
        half = int(below[0] / self._cell)
        self._map = dict.fromkeys(range(-half, half + 1), -below[1])  # cell → height [m]

    def update(self, measured: Measured) -> None:
        value = measured.value
        if isinstance(value, Odometry):
            self._place = self._place + value.moved
            self._angles = value.pitch, value.front, value.rear
        elif isinstance(value, Scan):
            hit = np.isfinite(value.ranges)
            angles, ranges = value.angles[hit], value.ranges[hit, None]
            rays = np.column_stack([np.cos(angles), np.sin(angles)])
            hits = self._place + turned(np.array(MOUNT) + ranges * rays, self._angles[0])
            cells = np.floor(hits[:, 0] / self._cell).astype(int)
            self._map.update(zip(cells.tolist(), hits[:, 1].tolist(), strict=True))

    def estimate(self, time: float) -> tuple[SensedGround, SensedAngles]:
        x, z = self._place
        reach = self._bins * self._width / 2
        cells = np.arange(np.ceil((x - reach) / self._cell), np.floor((x + reach) / self._cell))
        known = sorted(self._map)
        heights = np.interp(cells, known, [self._map[cell] for cell in known])
        points = np.column_stack([(cells + 0.5) * self._cell - x, heights - z])
        filled = np.array([cell not in self._map for cell in cells.tolist()])
        pitch, front, rear = self._angles
        ground = SensedGround(points, filled=filled)
        return ground, SensedAngles(front=front, rear=rear, pitch=pitch)

    def save(self) -> tuple[Any, ...]:
        return self._place, self._angles, dict(self._map)

    def load(self, saved: tuple[Any, ...]) -> None:
        self._place, self._angles, found = saved
        self._map = dict(found)


def turned(points: NDArray[np.float64], pitch: float) -> NDArray[np.float64]:
    """Rotate points (P, 2) by the pitch [rad]."""
    cos, sin = np.cos(pitch), np.sin(pitch)
    return points @ np.array([[cos, sin], [-sin, cos]])
