"""The instruments of ``perception=lidar``: what devices on the robot measure in simulation.

In: the true state, rays in the engine's world. Out: messages of ``flipperctl.core.lidar``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flipperctl.api import Instrument, RayWorld, RobotState
from flipperctl.core.lidar.body import Body
from flipperctl.core.lidar.estimator import Mount
from flipperctl.core.lidar.messages import Joints, Pose, Scan
from flipperctl.core.lidar.rotations import attitude, mounting
from flipperctl.sim.lidar.pattern import directions

SCAN_PERIOD = 0.1
"""Time between two scans, at 10 turns a second [s]."""


class Encoders(Instrument):
    """Measures the angles of the flippers."""

    def __init__(self, period: float | None) -> None:
        self.period = period

    def measure(self, state: RobotState, rng: np.random.Generator) -> Joints:
        """Return the true angles: encoders of geared joints err by far less than a policy feels."""
        return Joints(front=state.front, rear=state.rear)


class Tracking(Instrument):
    """Measures the pose of the robot without error."""

    def __init__(self, period: float | None) -> None:
        self.period = period

    def measure(self, state: RobotState, rng: np.random.Generator) -> Pose:
        """Return the true pose; frame M is the world."""
        x, z = state.position.tolist()
        return Pose(x=x, y=state.side, z=z, roll=state.roll, pitch=state.pitch, yaw=state.yaw)


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


class Scanner(Instrument):
    """Casts the rays of a LiDAR in the engine's world."""

    period = SCAN_PERIOD

    def __init__(
        self,
        azimuths: int,
        reach: float,
        errors: RangeErrors,
        mount: Mount,
        body: Body,
        world: RayWorld,
    ) -> None:
        """``reach``: farthest distance that returns [m]; ``body`` casts shadows."""
        self._reach, self._errors, self._near = reach, errors, mount.near
        self._body, self._world = body, world
        self._place = np.array([mount.x, 0.0, mount.z])
        self._rays = directions(azimuths)
        self._in_robot = self._rays @ mounting(mount.axis).T

    def measure(self, state: RobotState, rng: np.random.Generator) -> Scan:
        """Return the points of one turn, all measured at the same instant."""
        errors = self._errors
        turn = attitude(state.roll, state.pitch, state.yaw)
        x, z = state.position
        origin = np.array([x, state.side, z]) + turn @ self._place
        ground = self._world.cast_rays(origin, self._in_robot @ turn.T, self._reach)
        own = self._body.distances(self._place, self._in_robot, state.front, state.rear)
        true = np.minimum(ground, own)
        # Drawn for all rays, so that no draw depends on what the others met.
        measured = true + errors.bias + errors.noise * rng.standard_normal(len(true))
        lost = rng.random(len(true)) < errors.dropout
        if errors.resolution:
            steps = np.round(measured / errors.resolution)
            measured = errors.resolution * steps
        returned = (true >= self._near) & (true <= self._reach) & ~lost
        return Scan(self._rays[returned] * measured[returned, None])
