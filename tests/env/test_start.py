"""Starts past the first edge: the robot stands on a slope or a stair."""

import math
from dataclasses import replace

import numpy as np
import pytest

from flipperctl.api import Profile, Robot, Start, World
from flipperctl.env import flipper_env
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError, TerrainError
from flipperctl.sim.ground import height_at, resting
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.planar import Planar

RADIUS, AXLE, HALF = 0.1, 0.336, 0.28
EXACT = {"start_noise": 0.0}
STEEPEST = math.pi / 3


def slope(degrees: float) -> Profile:
    """Return a slope of 4 m along x."""
    return Profile([(0.0, 0.0), (4.0, 4.0 * math.tan(math.radians(degrees)))])


@pytest.mark.parametrize("degrees", [30.0, -30.0, 12.345])
def test_a_robot_rests_along_a_slope(degrees: float) -> None:
    angle = math.radians(degrees)
    pose = resting(slope(degrees), Robot(), 2.0, 0.0, 0.0, STEEPEST)
    assert pose is not None
    assert pose[0] == pytest.approx(2.0 * math.tan(angle) + RADIUS / math.cos(angle), abs=3e-5)
    assert pose[1] == pytest.approx(angle, abs=5e-5)


def test_a_robot_rests_on_the_edges_of_a_stair() -> None:
    stair = Profile([(0.3 * i, 0.2 * (i + j)) for i in range(10) for j in (0, 1)])
    pose = resting(stair, Robot(), 1.5, 0.0, 0.0, STEEPEST)
    assert pose is not None  # the axis is one radius above the line through the edges
    angle = math.atan2(0.2, 0.3)
    assert pose[1] == pytest.approx(angle, abs=1e-4)
    assert pose[0] == pytest.approx(0.2 + 1.5 * 0.2 / 0.3 + RADIUS / math.cos(angle), abs=1e-4)


def test_a_robot_rests_on_lowered_flippers() -> None:
    flat, robot = Profile([(0.0, 0.0)]), Robot()
    pose = resting(flat, robot, 0.0, -0.3, -0.3, STEEPEST)
    assert pose is not None
    assert pose == pytest.approx((RADIUS + AXLE * math.sin(0.3), 0.0), abs=3e-5)
    assert height_at(Start(0.0, -0.3, -0.3), flat, robot) == pytest.approx(pose[0], abs=3e-5)
    # On the front flipper's end and on the rear flipper, whose ends differ by AXLE sin(p - 0.2).
    pose = resting(flat, robot, 0.0, -0.2, 0.0, STEEPEST)
    assert pose is not None
    height, pitch = pose
    assert height + HALF * math.sin(pitch) + AXLE * math.sin(pitch - 0.2) == pytest.approx(RADIUS)
    assert height - (HALF + AXLE) * math.sin(pitch) == pytest.approx(RADIUS, abs=1e-4)


def test_a_robot_does_not_rest_over_a_cliff() -> None:
    cliff = Profile([(0.0, 0.0), (0.0, -3.0), (3.0, -3.0)])
    assert resting(cliff, Robot(), 0.05, 0.0, 0.0, STEEPEST) is None


@pytest.mark.parametrize(("sim", "direction"), [("planar", "up"), ("mujoco", "down")])
def test_an_episode_starts_on_a_slope_and_stays_on_it(sim: str, direction: str) -> None:
    ramp = {"name": "ramp", "direction": direction, "length_low": 2.4, "length_high": 3.0}
    env = FlipperEnv(ramp, sim=sim, episode={"run_up": -1.0})
    env.reset(seed=2)
    angle = math.radians(env.profile.drawn["slope"]) * (1 if direction == "up" else -1)
    assert env.state.position[0] == pytest.approx(1.0, abs=0.05)
    assert env.state.pitch == pytest.approx(angle, abs=1e-4)
    assert env.perception.pitch == pytest.approx(angle, abs=1e-4)
    env.step(4)  # holds the flippers
    moved = env.drive.poses[-1, :2] - env.drive.poses[0, :2]
    assert np.hypot(*moved) == pytest.approx(0.12, abs=0.015)  # 0.6 s at 0.2 m/s
    assert np.abs(env.drive.poses[:, 2] - angle).max() < 2e-3


def test_a_turned_robot_stands_on_a_slope_in_3d() -> None:
    profile, robot = slope(25.0), Robot()
    pose = resting(profile, robot, 2.0, 0.0, 0.0, STEEPEST)
    assert pose is not None
    start = Start(2.0, height=pose[0], pitch=pose[1])
    world = Mujoco(yaw=0.5).place(profile, robot, start, np.random.default_rng(1))
    state = world.state()
    assert abs(state.yaw) > 0.005
    assert world.penetration() < 1e-4
    assert state.orientation is not None  # its z axis is the normal of the slope
    normal = [-math.sin(pose[1]), 0.0, math.cos(pose[1])]
    assert state.orientation[:, 2] == pytest.approx(normal, abs=1e-9)


@pytest.mark.parametrize(
    ("episode", "text"),
    [
        ({"run_up": -9.0}, "starts past the finish of 'step'"),
        ({"run_up": -0.02}, "the robot cannot stand 0.02 m past the first edge of 'step'"),
    ],
)
def test_a_start_that_no_robot_can_have_is_named(episode: dict[str, float], text: str) -> None:
    cliff = {"name": "step", "low": -1.0, "high": -0.9}
    with pytest.raises(TerrainError, match=text):
        FlipperEnv(cliff, episode={**EXACT, **episode}).reset(seed=0)


def test_an_engine_that_starts_level_alone_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    place = Planar.place

    def level(
        self: Planar, profile: Profile, robot: Robot, start: Start, rng: np.random.Generator
    ) -> World:
        return place(self, profile, robot, Start(*start[:3]), rng)

    monkeypatch.setattr(Planar, "place", level)
    ramp = {"name": "ramp", "direction": "down", "length_low": 2.4, "length_high": 3.0}
    with pytest.raises(ConfigError, match="sim=planar does not place the robot along the ground"):
        FlipperEnv(ramp, episode={"run_up": -1.0}).reset(seed=2)


def test_a_lifted_start_leaves_later_episodes_on_the_same_profile_their_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    profile = replace(slope(20.0), run_up=-1.0)
    lifted = iter((True, False))
    monkeypatch.setattr(flipper_env.ground, "generate_profile", lambda *args: profile)
    monkeypatch.setattr(flipper_env.start, "is_lifted", lambda world, start: next(lifted))
    env = FlipperEnv("flat")
    env.reset(seed=1)
    assert env.state.position[0] < profile.start
    env.reset(seed=2)
    assert env.state.position[0] > profile.start + 0.5
