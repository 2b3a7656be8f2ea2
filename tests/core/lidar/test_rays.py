"""What is done with rays: those without return, and those whose beginning is unknown."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from flipperctl.core.arrays import FloatArray
from flipperctl.core.lidar.body import Mount
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.ground import MapSettings
from flipperctl.core.lidar.messages import Joints, Scan, thinned, without_near
from tests.core.lidar.level_ground import BODY, LEVEL, UP, told

EDGE, DROP = 0.35, 0.5


def seen_over_an_edge() -> FloatArray:
    """Return points in frame R of ground that drops, as a LiDAR 0.5 m above it sees them."""
    lidar = np.array([UP.x, 0.0, UP.z])
    found = []
    for down in np.arange(0.1, 1.5, 0.004):
        for side in np.arange(-0.6, 0.61, 0.05):
            ray = np.array([math.cos(down), side, -math.sin(down)])
            point = lidar + ray * (0.5 / -ray[2])
            if point[0] > EDGE:
                point = lidar + ray * ((0.5 + DROP) / -ray[2])
                if point[0] < EDGE:  # the edge hides it
                    continue
            found.append(point)
    return np.array(found)


@pytest.mark.parametrize("place", [lambda p: (UP, p - (UP.x, 0.0, UP.z)), None])
def test_clouds_in_the_frame_of_the_chassis_erase_no_ground(
    place: Callable[[FloatArray], tuple[Mount, FloatArray]] | None,
) -> None:
    """Their rays do not begin at its origin, below which they would pass the ground."""
    points = seen_over_an_edge()
    chassis = Mount(x=0.0, z=0.0, axis=math.pi / 2, near=0.1, margin=0.02), points
    mount, points = chassis if place is None else place(points)
    robot = LidarEstimator(BODY, mount, MapSettings(bins=15, bin_width=0.15))
    told(robot, LEVEL, Joints(0.5, 0.5))
    robot.estimate(0.0)
    for _ in range(3):
        told(robot, Scan(points))
    heights = robot.estimate(0.0)[0].heights
    assert heights[8] == pytest.approx(-0.1, abs=0.01)  # 0.075 to 0.225 m ahead
    assert heights[-1] == pytest.approx(-0.1 - DROP, abs=0.02)


def test_rays_without_return_take_no_part() -> None:
    points = np.column_stack([np.arange(1.0, 5.0), np.zeros(4), np.zeros(4)])
    both = np.concatenate([points, np.zeros((100, 3))])
    ages = np.arange(104.0)
    found = thinned(without_near(Scan(both, ages), 0.1), 4)
    assert found.points.tolist() == points.tolist()
    assert found.ages is not None
    assert found.ages.tolist() == [0.0, 1.0, 2.0, 3.0]
    scan = Scan(points)
    assert without_near(scan, 0.1) is scan
