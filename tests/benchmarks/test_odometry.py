"""The benchmark of the estimator: errors of a drive that is known by hand."""

import numpy as np
import pytest

from benchmarks.drives import Decided, Recorded, occupied
from benchmarks.odometry import HEADER, errors, line
from flipperctl.api import Measured
from flipperctl.core.lidar.messages import Belts, Inertial, Joints
from flipperctl.sim.lidar import LidarSensor


def drive(slip: float) -> Recorded:
    """Return 10 s over level ground at 0.2 m/s of the belts, of which this fraction slips."""
    messages, decided = [], []
    for k in range(101):
        time = 0.1 * k
        values = (Belts(0.2), Inertial(0.0, 0.0, 0.0), Joints(0.0, 0.0))
        messages += [Measured("device", time, value) for value in values]
        pose = np.array([0.2 * time * (1 - slip), 0.0, 0.1, 0.0])
        decided.append(Decided(time, len(messages), pose, np.full(15, -0.1)))
    return Recorded(tuple(messages), tuple(decided))


def test_drift_is_the_difference_of_the_motions() -> None:
    found = errors(drive(0.2), LidarSensor(pose="belts"))
    assert found.way == pytest.approx(1.6)
    assert found.along == pytest.approx(0.4)
    assert found.up == pytest.approx(0.0)
    assert not len(found.heights)  # nothing was scanned
    assert occupied(np.zeros(15)).sum() == 5


def test_a_row_has_a_cell_for_each_column() -> None:
    found = errors(drive(0.0), LidarSensor(pose="belts"))
    cells = {"below": [0.01], "heights": [0.01], "relative": [1.0], "seconds": [0.005]}
    measured = {name: np.array(values) for name, values in cells.items()}
    row = line("level", [type(found)(found.way, found.along, found.up, **measured)])
    assert len(row.split()) == 1 + len(HEADER.splitlines()[1].split())
    assert row.split()[6:9] == ["1.00", "1.00", "1.00"]
