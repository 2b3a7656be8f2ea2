"""Where the LiDAR's rays meet the robot itself."""

import numpy as np
import pytest

from flipperctl.core.lidar.body import Body
from flipperctl.sim.lidar.scanner import OwnHits

BODY = Body(0.76, 0.536, 0.1, 0.352, 0.712)


@pytest.mark.parametrize("side", [0.0, 0.1])
def test_no_ray_that_can_hit_a_flipper_is_left_out_whatever_the_angles(side: float) -> None:
    rng = np.random.default_rng(0)
    origin = np.array([0.25, side, 0.4])
    rays = rng.standard_normal((2000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    own, possible = OwnHits(BODY, origin, rays), BODY.may_hit_flippers(origin, rays)
    assert 0.1 < possible.mean() < 0.6  # or nothing is saved
    for angle in np.linspace(-1.5, 1.5, 13):
        flippers = BODY.distances_to_flippers(origin, rays, angle, -angle)
        assert not (np.isfinite(flippers) & ~possible).any()
        assert (own.distances(angle, -angle) == BODY.distances(origin, rays, angle, -angle)).all()
