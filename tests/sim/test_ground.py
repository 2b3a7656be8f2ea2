"""Thinning against numbers worked by hand, and bounds on ground."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flipperctl.api import Profile, Terrain
from flipperctl.config import EnvConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import TerrainError
from flipperctl.sim.ground import FEW, LONGEST, MOST, TOLERANCE, check_extent, inflated, thinned
from flipperctl.testing.recorded import NoReward

RADIUS = 0.1  # [m]


def fine(
    height: Callable[[np.ndarray], np.ndarray], length: float = 2.0, count: int = 20_001
) -> Profile:
    """Return ground of this height(x) with a point every 0.1 mm."""
    x = np.linspace(0.0, length, count)
    return Profile(np.column_stack([x, height(x)]))


def felt(profile: Profile, at: np.ndarray, radius: float) -> np.ndarray:
    """Return the lowest height of a disc that rests on the ground with its centre at ``at`` [m]."""
    x = np.arange(profile.start, profile.end, 1e-4)
    z = np.interp(x, *profile.points.T)
    heights = []
    for centre in at:
        near = np.abs(x - centre) < radius
        heights.append((z[near] + np.sqrt(radius**2 - (x[near] - centre) ** 2)).max() - radius)
    return np.array(heights)


def test_slopes_keep_their_ends_and_arcs_are_kept_to_the_tolerance() -> None:
    assert thinned(fine(lambda x: 0.3 * x), RADIUS).points.tolist() == [[0.0, 0.0], [2.0, 0.6]]
    # A chord of d lies d²/8r below its arc: with r = 5 m and 0.1 mm, d = 63 mm.
    found = thinned(fine(lambda x: np.sqrt(25 - (x - 1) ** 2)), RADIUS).points
    assert 2 / 0.0633 < len(found) < 2 / 0.0633 + 5
    x = np.linspace(0, 2, 5001)
    off = np.interp(x, *found.T) - np.sqrt(25 - (x - 1) ** 2)
    assert np.abs(off).max() < 1.05 * TOLERANCE


def test_a_hollow_that_no_track_enters_is_left_out_and_a_wider_one_stays() -> None:
    # On edges 5 mm apart a disc of 0.1 m sinks by 0.03 mm, on edges 20 mm apart by 0.5 mm.
    def hollow(width: float) -> Profile:
        return fine(lambda x: -0.003 * (np.abs(x - 1.0) < width / 2))

    assert thinned(hollow(0.005), RADIUS).points[:, 1].min() == 0.0
    assert thinned(hollow(0.020), RADIUS).points[:, 1].min() == -0.003


def test_vertical_faces_stay_vertical() -> None:
    level = np.linspace(0.0, 1.0, 2001)
    points = np.vstack(
        [np.column_stack([level, 0 * level]), np.column_stack([1 + level, 0 * level + 0.2])]
    )
    assert thinned(Profile(points), RADIUS).points.tolist() == [[0, 0], [1, 0], [1, 0.2], [2, 0.2]]


def test_a_disc_rolls_over_a_corner() -> None:
    line = np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 0.2], [2.0, 0.2]])
    # At 0.54 and 0.74 m on level ground, 0.06 m before the corner at 0.2 + √(0.1² - 0.06²), on top
    assert inflated(line, 0.54, 0.2, 4, RADIUS) == pytest.approx([0.1, 0.1, 0.28, 0.3])


@pytest.mark.parametrize("grain", [0.0, 2e-4, 2e-3])
def test_a_track_feels_the_same_ground(grain: float) -> None:
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, grain, 20_001)
    whole = fine(lambda x: 0.05 * np.sin(5 * x) + 0.01 * np.sin(31 * x) + noise)
    thin = thinned(whole, RADIUS)
    assert len(thin.points) < 700
    assert thin.points[[0, -1]].tolist() == whole.points[[0, -1]].tolist()
    at = np.linspace(0.1, 1.9, 200)
    # The tolerance is square to slopes of up to 0.56, so √(1 + 0.56²) = 1.15 of it upright.
    assert np.abs(felt(whole, at, RADIUS) - felt(thin, at, RADIUS)).max() < 1.16 * TOLERANCE


def test_coarse_ground_and_short_profiles_are_not_thinned() -> None:
    few = fine(lambda x: 0 * x, count=FEW)
    coarse = fine(lambda x: 0 * x, length=20.0, count=2001)
    assert thinned(few, RADIUS) is few
    assert thinned(coarse, RADIUS) is coarse


def test_ground_has_bounds() -> None:
    x = np.linspace(0, 500.0, MOST + 1)
    with pytest.raises(
        ValueError, match=rf"has {MOST + 1} points after thinning .* at most {MOST}"
    ):
        check_extent(Profile(np.column_stack([x, np.sin(x)])))
    with pytest.raises(ValueError, match=r"is 5e\+04 m long; at most 2000 m.*unit"):
        check_extent(Profile([(0, 0), (50_000, 0)]))
    with pytest.raises(ValueError, match="is inf m long"):
        check_extent(Profile([(0, -1e308), (1, 1e308)]))
    check_extent(Profile([(0, 0), (LONGEST, 0)]))


class Drawn(Terrain):
    plugin_name = "drawn"
    points: Any

    def generate(self, rng: np.random.Generator) -> Profile:
        return Profile(self.points)


def drive_on(points: Any) -> FlipperEnv:
    terrain = Drawn(points=points)
    return FlipperEnv(config=EnvConfig(terrain=terrain, rewards={"none": NoReward()}))


def test_an_episode_drives_on_thinned_ground() -> None:
    env = drive_on(fine(lambda x: 0.05 * np.sin(3 * x)).points)
    env.reset(seed=0)
    assert env.points_drawn == 20_001
    assert len(env.profile.points) < 150
    before = env.state.position[0]
    env.step(4)
    assert env.state.position[0] - before == pytest.approx(0.12, abs=0.03)
    with pytest.raises(TerrainError, match=r"terrain 'drawn'.*1e\+06 m of length"):
        drive_on([(0, 0), (1e6, 0)]).reset(seed=0)
