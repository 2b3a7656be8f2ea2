"""Both sides and the roll in observations, in the side plane and in 3-D."""

import numpy as np
import pytest

from flipperctl.api import Profile, Robot, RobotState, Start
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.planar.sensing import ground_beside

N = 15
ERRORS = {"noise": 0.01, "dropout": 0.1, "angle_noise": 0.01, "map_error": 0.004, "occlusion": True}


def parts(env: FlipperEnv) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return the heights of the whole width, of the left and of the right, (2, N), and the roll."""
    seen = env.perception.observation
    whole, left, right = seen[: 6 * N].reshape(3, 2, N)
    return whole, left, right, float(seen[6 * N])


@pytest.mark.parametrize("sim", ["planar", "mujoco"])
@pytest.mark.parametrize("errors", [{}, ERRORS], ids=["exact", "errors"])
def test_the_other_numbers_are_those_without_sides(sim: str, errors: dict[str, float]) -> None:
    envs = [
        FlipperEnv("pallet", sim=sim, perception={**errors, "sides": sides})
        for sides in (False, True)
    ]
    plain, sided = (env.reset(seed=3)[0] for env in envs)
    assert (plain.shape, sided.shape) == ((33,), (94,))
    assert envs[1].observation_space.contains(sided)
    # At the first decision, before the noise of the sides has drawn numbers of its own
    assert sided[: 2 * N].tolist() == plain[: 2 * N].tolist()
    assert sided[-3:].tolist() == plain[-3:].tolist()
    for _ in range(9):
        envs[1].step(4)
    whole, left, right, roll = parts(envs[1])
    if sim == "planar":
        assert np.array_equal(left, whole)
        assert np.array_equal(right, whole)
        assert roll == pytest.approx(0.0, abs=0.05)
    else:
        assert left[:, 1:-1] == pytest.approx(whole[:, 1:-1], abs=0.25 if errors else 0.1)


@pytest.mark.parametrize("sensor", ["planar", "lidar"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_an_obstacle_on_one_side_is_seen_there_alone(sensor: str, mirrored: bool) -> None:
    sim = {"name": "mujoco", "one_sided": 1.0, "mirrored": mirrored, "lateral_slope": 0.1}
    env = FlipperEnv("pallet", sim=sim, perception={"name": sensor, "sides": True})
    env.reset(seed=3)
    for _ in range(9):
        env.step(4)
    _, left, right, roll = parts(env)
    obstacle, level = (right, left) if mirrored else (left, right)
    assert np.ptp(obstacle[1]) > 0.15
    assert np.ptp(level[1]) < 0.03
    assert roll == pytest.approx(env.state.roll, abs=0.01)
    # The ground leans to one side by 0.1 rad: its sides' middles are 0.36 m apart.
    lean = -0.036 if mirrored else 0.036
    assert left[0, 2] - right[0, 2] == pytest.approx(lean, abs=0.015)
    assert env.perception.roll == pytest.approx(roll)


def test_points_below_the_tracks_are_in_frame_l_by_hand() -> None:
    # 0.2 m up on the left at x from 0 on, seen by a robot that has turned to the left by 90°
    block = Profile([(0, 0), (0, 0.2), (2, 0.2), (2, 0)])
    world = Mujoco(one_sided=1.0).place(block, Robot(), Start(-1.0), np.random.default_rng(0))
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    place = {"pitch": 0.0, "front": 0.0, "rear": 0.0, "pitch_rate": 0.0, "time": 0.0}
    state = RobotState(
        np.array([-0.1, 0.5]), velocity=np.zeros(2), side=0.0, orientation=turned, **place
    )
    points = ground_beside(world, state, 1.0)
    assert np.abs(points[:, 1]).max() < 0.36
    high = points[points[:, 2] > -0.4]
    # The obstacle begins 0.1 m to the robot's right, and ahead of it, where world's y is positive.
    assert high[:, :2].min(axis=0) == pytest.approx([0.0, -0.315], abs=0.02)
    assert high[:, 1].max() == pytest.approx(-0.1, abs=0.1)
    assert high[:, 2] == pytest.approx(-0.3, abs=1e-6)


@pytest.mark.parametrize("sim", [{"one_sided": 1.0}, {"oblique": 0.4}, {"stagger": 0.3}])
def test_a_step_from_side_to_side_is_no_slope_for_the_map(sim: dict[str, float]) -> None:
    envs = [
        FlipperEnv("paper_step", sim={"name": "mujoco", **sim}, perception=sensor | {"sides": True})
        for sensor in ({}, {"name": "lidar"})
    ]
    for seed in range(3):
        exact, mapped = (env.reset(seed=seed)[0][: 6 * N].reshape(6, N) for env in envs)
        seen = envs[1].perception.seen
        assert seen is not None
        assert seen.mean() > 0.4
        # Ground below the tracks that was seen has its height.
        assert np.median(np.abs(exact - mapped)[2:, seen]) < 0.02
