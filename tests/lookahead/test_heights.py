"""Heights around predicted places against what the environment's sensor perceives."""

import numpy as np
import pytest

from flipperctl.api import ObservationLayout
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.lookahead.model import Ground, Model


@pytest.mark.parametrize(
    "terrain", ["flat", "paper_step", "paper_stair", "gap", "rubble", "wave", "pallet", "plum"]
)
def test_observations_are_those_of_the_environment(terrain: str) -> None:
    """Both take points every 0.02 m, one of which may lie in the bin beside an edge."""
    env = FlipperEnv(terrain)
    rng = np.random.default_rng(2)
    observation, _ = env.reset(seed=3)
    ground, model = (
        Ground(env.profile.extended(3.0, 3.0), env.layout),
        Model(env.profile.points, env.robot),
    )
    places, states, seen = [], [], []
    running = True
    while running and env.state.position[0] < env.drive.termination.finish:
        state = env.state
        x, z = state.position.tolist()
        places.append((x, z))
        states.append(model.state((x, z, state.pitch), (state.front, state.rear)))
        seen.append(observation)
        action = int(rng.integers(9)) if rng.random() < 0.3 else 4
        observation, _, terminated, truncated, _ = env.step(action)
        running = not (terminated or truncated)
    found = ground.observations(np.array(places), np.array(states))
    off = np.abs(found - np.array(seen))
    assert len(off) > 25
    assert off[:, -3:].max() == 0.0
    assert np.quantile(off, 0.95) < 0.005
    assert off.max() < 0.015


def test_a_bin_without_points_has_the_height_of_the_line_in_its_middle() -> None:
    """Many bins 0.012 m wide hold none of the points, which are 0.02 m apart."""
    layout = ObservationLayout(bins=15, bin_width=0.012)
    slope = np.array([[-1.0, -0.5], [1.0, 0.5]])
    place, state = np.array([[0.1, 0.3]]), np.zeros((1, 10))
    found = Ground(slope, layout).observations(place, state)[0, :15]
    middles = 0.1 + 0.012 * np.arange(-7, 8)
    assert found == pytest.approx(middles / 2 - 0.3, abs=0.0031)  # half a bin, at a slope of 1/2


def test_level_ground_goes_on_beyond_both_ends() -> None:
    line = np.array([[0.0, 0.1], [1.0, 0.4]])
    places, state = np.array([[-5.0, 0.0], [9.0, 0.0]]), np.zeros((2, 10))
    found = Ground(line, ObservationLayout()).observations(places, state)[:, :15]
    assert found[0] == pytest.approx(0.1)
    assert found[1] == pytest.approx(0.4)


def test_a_face_counts_by_its_points() -> None:
    """A bin of 0.15 m around a face of 0.3 m: 3.75 points at 0, 15 on it, 3.75 at 0.3."""
    line = np.array([[-2.0, 0.0], [0.0, 0.0], [0.0, 0.3], [2.0, 0.3]])
    found = Ground(line, ObservationLayout()).observations(np.zeros((1, 2)), np.zeros((1, 10)))[0]
    expected = (3.75 * 0.0 + 15 * 0.15 + 3.75 * 0.3) / 22.5
    assert found[7] == pytest.approx(expected, abs=0.01)
    assert found[6] == pytest.approx(0.0)
    assert found[8] == pytest.approx(0.3)
