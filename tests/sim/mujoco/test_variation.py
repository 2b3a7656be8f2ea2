"""What the side plane cannot show: heading, lateral slope, roll, and falling off the ground."""

import math

import numpy as np
import pytest

from flipperctl.api import EndingWorld, Outcome, Profile, Robot, Start, action_index
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.mujoco.world import MujocoWorld

FLAT = Profile([(0.0, 0.0)])


def place(x: float = 0.0, profile: Profile = FLAT, **sim: float) -> MujocoWorld:
    world = Mujoco(**sim).place(profile, Robot(), Start(x), np.random.default_rng(0))
    assert isinstance(world, MujocoWorld)
    return world


def turn(world: MujocoWorld, yaw: float) -> None:
    world.data.qpos[3:7] = math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)


@pytest.mark.parametrize("yaw", [-0.3, 0.3])
def test_steering_brings_the_robot_back_to_the_middle(yaw: float) -> None:
    steered, free = place(), place(heading_gain=0.0)
    for world in (steered, free):
        turn(world, yaw)
        assert world.yaw == pytest.approx(yaw)
        world.advance(2000)
    assert steered.yaw == pytest.approx(0.0, abs=0.02)
    assert steered.state().side == pytest.approx(0.0, abs=0.02)
    # 20 s at 0.2 m/s are 4 m along its heading
    assert free.yaw == pytest.approx(yaw, abs=0.01)
    assert free.state().side == pytest.approx(4.0 * math.sin(yaw), rel=0.02)


def test_on_a_lateral_slope_the_robot_rolls_and_holds_its_line() -> None:
    world = place(lateral_slope=0.2)
    assert world.roll == pytest.approx(0.2)  # against gravity, left up
    world.advance(1000)
    state = world.state()
    assert (state.roll, state.pitch) == pytest.approx((0.2, 0.0), abs=2e-3)
    assert state.position[0] == pytest.approx(2.0, rel=0.02)
    assert abs(state.side) < 0.05


def test_the_lower_side_is_the_right_one() -> None:
    # With a friction of 0.1 it slides down a slope of 0.2 rad, to the right.
    world = place(lateral_slope=0.2, friction=0.1)
    world.advance(100)
    assert world.state().side < -0.2


def test_a_roll_ends_as_overturned() -> None:
    env = FlipperEnv("flat", sim={"name": "mujoco", "lateral_slope": 0.2, "roll_limit": 0.1})
    env.reset(seed=0)
    *_, terminated, truncated, info = env.step(4)
    assert (info["outcome"], terminated, truncated) == (Outcome.OVERTURNED, True, False)


@pytest.fixture
def narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the ground end 0.5 m beside the line."""
    monkeypatch.setattr("flipperctl.sim.mujoco.world.GROUND_WIDTH", 1.0)


@pytest.mark.usefixtures("narrow")
def test_leaving_the_ground_sideways_ends_as_overturned() -> None:
    world = place(heading_gain=0.0)
    assert isinstance(world, EndingWorld)
    turn(world, 0.7)
    assert world.ended() is None
    poses = world.advance(1000)
    assert len(poses) < 1000
    assert world.state().side > 0.5
    assert world.ended() is Outcome.OVERTURNED


@pytest.mark.usefixtures("narrow")
def test_an_end_of_the_worlds_own_ends_the_episode() -> None:
    sim = {"name": "mujoco", "heading_gain": 0.0, "yaw": 0.7}
    env = FlipperEnv("flat", sim=sim)
    env.reset(seed=5)  # whose heading is 0.69 rad
    for _ in range(200):
        *_, terminated, truncated, info = env.step(action_index(0, 0))
        if terminated or truncated:
            break
    assert info["outcome"] is Outcome.OVERTURNED
    assert abs(env.state.side) > 0.5
    assert abs(env.state.pitch) < 0.1


def lateral(env: FlipperEnv, seed: int) -> tuple[float, float, list[float]]:
    """Return yaw, sideways position and heights of the ground at the start of an episode."""
    env.reset(seed=seed)
    world = env.drive.world.unguarded
    return world.yaw, env.state.side, world.model.geom_pos[:, 2].tolist()


@pytest.mark.parametrize("setting", ["yaw", "offset", "roughness"])
def test_the_seed_draws_what_varies_though_ground_and_start_are_the_same(setting: str) -> None:
    exact = {"start_noise": 0.0}
    envs = [
        FlipperEnv("paper_step", sim={"name": "mujoco", setting: 0.05, **more}, episode=exact)
        for more in ({}, {"variation": 1})
    ]
    drawn = [lateral(envs[0], seed) for seed in (1, 2, 3)]
    assert drawn[0] != drawn[1] != drawn[2] != drawn[0]
    assert lateral(envs[0], 1) == drawn[0]
    assert lateral(envs[1], 1) != drawn[0]
    assert lateral(envs[1], 1) == lateral(envs[1], 1)


def test_a_policy_that_looks_ahead_foresees_the_same_yaw() -> None:
    env = FlipperEnv("step", sim={"name": "mujoco", "yaw": 0.3, "offset": 0.2, "roughness": 0.02})
    env.reset(seed=5)
    simulator = env.simulator()
    for _ in range(2):
        simulator.restart()
        for action in (8, 4, 0):
            simulator.step(action)
        foreseen = simulator.poses
    for action in (8, 4, 0):
        env.step(action)
    assert np.array_equal(foreseen, env.drive.poses)
    assert simulator.state.side == env.state.side
