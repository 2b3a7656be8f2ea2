"""The window of the map turns with the robot and forgets nothing that it still covers."""

import math
from dataclasses import replace

import numpy as np
import pytest

from flipperctl.core.lidar.cells import Cells, Grid, TurningCells
from flipperctl.core.lidar.messages import Joints, Scan
from tests.core.lidar.level_ground import LEVEL, ahead, estimator, told


@pytest.mark.parametrize("yaw", [0.3, 0.5, math.pi / 2, math.pi, -2.5])
def test_the_ground_ahead_is_the_same_whichever_way_the_robot_heads(yaw: float) -> None:
    found = []
    for x, y, heading in ((0.0, 0.0, 0.0), (3.0, -2.0, yaw)):
        robot = told(estimator(), replace(LEVEL, x=x, y=y, yaw=heading), Joints(0.0, 0.0))
        robot.estimate(0.0)
        points = ahead().points
        points[points[:, 0] > 0.5, 2] += 0.15  # a step, 0.75 m ahead of the centre
        found.append(told(robot, Scan(points)).estimate(0.0)[0])
    straight, turned = found
    assert straight.seen is not None
    assert turned.seen is not None
    assert turned.seen.tolist() == straight.seen.tolist()
    assert turned.heights == pytest.approx(straight.heights, abs=0.03)
    assert straight.heights[13] == pytest.approx(0.05, abs=0.01)


def test_a_robot_that_turns_and_turns_back_remembers_what_it_saw() -> None:
    robot = told(estimator(), LEVEL, Joints(0.0, 0.0), ahead())
    robot.estimate(0.0)
    for turn in (0.5, 0.1, -0.5, 0.0):
        told(robot, replace(LEVEL, yaw=turn)).estimate(0.0)
    ground, _ = robot.estimate(0.0)
    assert ground.seen is not None
    assert ground.seen[11:].all()
    assert ground.heights[11:] == pytest.approx(-0.1, abs=0.02)


def test_a_turned_window_holds_the_newest_points_and_when_they_were_seen() -> None:
    grid = Grid(cell=0.1, lane=0.1, keep=2)
    cells, turning = Cells(grid, 2.0, 1.0), TurningCells(grid, 2.0, 1.0)
    for at, height in enumerate((0.0, 0.1, 0.2)):
        point = np.array([[0.0, 1.55, height], [0.0, 0.55, height]])
        turning.face(0.0, 0.0, math.pi / 2)
        turning.add(point, 0.0, 0.0, float(at))
        cells.add(point[:, [1, 0, 2]], 0.0, 0.0, float(at))
    held = {tuple(row) for row in np.round(cells.held()[0], 6).tolist()}
    assert held == {(x, 0.0, z) for x in (1.55, 0.55) for z in (0.1, 0.2)}
    for _ in range(2):
        found = turning.around(0.0, 0.0, math.pi / 2, (-2.0, 2.0), 0.5)
        assert {tuple(row) for row in np.round(found, 6) + 0.0} == held
        along, way = turning.seen_at(0.0, 0.0, math.pi / 2, (-2.0, 2.0), 0.5)
        assert sorted(along) == pytest.approx([0.55, 1.55], abs=1e-6)
        assert way.tolist() == [2.0, 2.0]
        before = turning.save()
        turning.face(0.0, 0.0, math.pi / 2 + 0.4)  # an oblique window, and back
        turning.face(0.0, 0.0, math.pi / 2)
    turning.load(before)
    assert np.array_equal(turning.around(0.0, 0.0, math.pi / 2, (-2.0, 2.0), 0.5), found)
