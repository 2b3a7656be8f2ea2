"""A robot on level ground that sees some of it ahead."""

import math

import numpy as np

from flipperctl.core.lidar.body import Body, Mount
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.ground import MapSettings
from flipperctl.core.lidar.messages import Joints, Pose, Scan
from flipperctl.core.observation import FloatArray
from flipperctl.core.sensing import Measured, SensedGround

BODY = Body(0.76, 0.536, 0.1, 0.352, 0.712)
UP = Mount(x=0.25, z=0.4, axis=math.pi / 2, near=0.1, margin=0.02)  # frame S is level
LEVEL = Pose(0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
STILL = Joints(0.0, 0.0)


def estimator(mount: Mount = UP, *, level: bool = True, **settings: object) -> LidarEstimator:
    chosen = MapSettings(bins=15, bin_width=0.15, **settings)  # type: ignore[arg-type]
    return LidarEstimator(BODY, mount, chosen, level=level)


def told(robot: LidarEstimator, *values: object, time: float = 0.0) -> LidarEstimator:
    for value in values:
        robot.update(Measured("device", time, value))
    return robot


def started(*values: object) -> LidarEstimator:
    """Return a robot that has stood on level ground, and has then been told more."""
    robot = told(estimator(), LEVEL, STILL)
    robot.estimate(0.0)
    return told(robot, *values)


def ground_of(robot: LidarEstimator, time: float = 0.0) -> SensedGround:
    return robot.estimate(time)[0]


def heights_of(robot: LidarEstimator, time: float = 0.0) -> FloatArray:
    """Return mean and highest point of each bin, (2, 15) [m]."""
    found = ground_of(robot, time).heights
    assert found is not None
    return found.reshape(2, -1)


def ahead(error: float = 0.0) -> Scan:
    """Return points in frame S of level ground 0.5 m below it, from 0.2 to 1 m ahead."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0.2, 1.0, 0.005), np.arange(-0.3, 0.31, 0.1)))
    return Scan(np.column_stack([x, y, np.full(len(x), -0.5 + error)]))
