"""The functions of the core that the simulator compiles give the same, compiled or not."""

import numpy as np
import pytest

from flipperctl.core.ground_map import kept_points
from flipperctl.core.observation import fill_gaps
from flipperctl.sim import ground as thinning
from flipperctl.sim.planar import rays


@pytest.mark.parametrize("span", [0.0, 0.05])
def test_thinning(span: float) -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([np.sort(rng.uniform(0, 1, 200)), rng.normal(0.0, 0.003, 200)])
    points.setflags(write=False)  # as a profile's, for which the function is compiled already
    arguments = points, rng.random(200) < 0.05, 0.002, span
    keep = kept_points(*arguments)
    assert keep.tolist() == thinning.kept_points(*arguments).tolist()
    assert 2 < keep.sum() < 200


def test_filling() -> None:
    x = np.array([0.0, 0.1, 0.2, 0.9, 1.0])
    points = np.column_stack([x, x**2])
    arguments = points, np.array([0, 1, 2, 9, 10]), x != 0.1, 0.1, (-0.35, 1.25)
    (line, filled), compiled = fill_gaps(*arguments), rays.fill_gaps(*arguments)
    assert (line.tolist(), filled.tolist()) == (compiled[0].tolist(), compiled[1].tolist())
    assert line[~filled].tolist() == points[x != 0.1].tolist()
    # 0.35 m before, √(0.7² + 0.77²) = 1.04 m within and 0.25 m past the points: 3 + 10 + 2
    assert filled.sum() == 15
