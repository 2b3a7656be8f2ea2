"""Starts and finishes on the obstacle, and grounds that choose their own."""

import math
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from flipperctl.api import Limits, Outcome, Profile, Robot, Start, Terrain, World, registry, terrain
from flipperctl.config import Episode
from flipperctl.env import flipper_env
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.start import finish_of, is_lifted, nearest_rest
from flipperctl.errors import ConfigError, TerrainError
from flipperctl.sim.ground import height_at, resting
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.planar import Planar

RADIUS, AXLE, HALF, CLEARANCE = 0.1, 0.336, 0.28, 0.1
EXACT = {"start_noise": 0.0}
STEEPEST = math.pi / 3
HOLD = 4
ANGLE = math.radians(20)


def slope(degrees: float) -> Profile:
    """Return a slope of 4 m along x."""
    return Profile([(0.0, 0.0), (4.0, 4.0 * math.tan(math.radians(degrees)))])


UP = slope(20.0)


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
    ramp = {"name": "ramp", "direction": direction, "length": [2.4, 3.0]}
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
        ({"run_out": -5.0}, r"the finish of 'step' lies 4\.00 m behind the start"),
    ],
)
def test_a_start_or_finish_that_no_robot_can_have_is_named(
    episode: dict[str, float], text: str
) -> None:
    cliff = {"name": "step", "height": [-1.0, -0.9]}
    with pytest.raises(TerrainError, match=text):
        FlipperEnv(cliff, episode={**EXACT, **episode}).reset(seed=0)


def test_an_engine_that_starts_level_alone_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    place = Planar.place

    def level(
        self: Planar, profile: Profile, robot: Robot, start: Start, rng: np.random.Generator
    ) -> World:
        return place(self, profile, robot, Start(*start[:3]), rng)

    monkeypatch.setattr(Planar, "place", level)
    ramp = {"name": "ramp", "direction": "down", "length": [2.4, 3.0]}
    with pytest.raises(ConfigError, match="sim=planar does not place the robot along the ground"):
        FlipperEnv(ramp, episode={"run_up": -1.0}).reset(seed=2)


def test_a_start_is_lifted_more_than_15_cm_above_that_of_the_profile() -> None:
    world = SimpleNamespace(position=(0.0, 0.3))
    heights = (None, 0.16, 0.14)
    lifted = [is_lifted(cast(World, world), Start(0.0, height=height)) for height in heights]
    assert lifted == [False, False, True]


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


def test_the_finish_on_a_slope_is_as_high_as_a_robot_along_it() -> None:
    finish = finish_of(UP, Robot(), Episode(run_out=-1.0))
    assert finish.x == 3.0
    assert finish.slope == pytest.approx(math.tan(ANGLE), abs=1e-4)
    centre = 3.0 * math.tan(ANGLE) + RADIUS / math.cos(ANGLE)
    assert finish.top == pytest.approx(centre + HALF * math.sin(ANGLE) + CLEARANCE, abs=1e-4)
    # The ground past the edge is higher, and counts from there on.
    past = 4.0 * math.tan(ANGLE) + RADIUS + CLEARANCE
    assert (finish.end, finish.level) == (4.0, pytest.approx(past))
    down = finish_of(Profile(UP.points * (1.0, -1.0)), Robot(), Episode(run_out=-1.0))
    assert down.slope == pytest.approx(-math.tan(ANGLE), abs=1e-4)
    assert down.level == pytest.approx(-4.0 * math.tan(ANGLE) + RADIUS + CLEARANCE)
    level = finish_of(UP, Robot(), Episode())
    assert level.x == 5.0
    assert level.top == pytest.approx(4.0 * math.tan(ANGLE) + RADIUS + CLEARANCE)
    assert (level.slope, level.end, level.level) == (0.0, math.inf, -math.inf)


def test_the_allowed_height_follows_the_slope_down_to_the_level_ground() -> None:
    limits = Limits(angle=1.0, x=2.0, top=1.0, half=0.0, slope=-0.5, end=8.0, level=0.2)
    assert not limits.reached(1.9, 0.0, 0.0)
    assert limits.reached(3.0, 0.5, 0.0)
    assert not limits.reached(3.0, 0.51, 0.0)
    assert limits.reached(7.0, 0.2, 0.0)  # the line lies below the level ground
    assert not limits.reached(7.0, 0.21, 0.0)
    assert not limits.reached(9.0, 0.21, 0.0)


def test_past_the_last_edge_higher_ground_counts() -> None:
    limits = Limits(angle=1.0, x=2.0, top=1.0, half=0.0, slope=0.0, end=8.0, level=1.5)
    assert limits.reached(7.9, 1.0, 0.0)
    assert not limits.reached(7.9, 1.01, 0.0)  # as a robot that stands up at the finish
    assert limits.reached(8.0, 1.5, 0.0)
    assert not limits.reached(8.0, 1.51, 0.0)


@pytest.mark.parametrize(("sim", "direction"), [("planar", "up"), ("mujoco", "down")])
def test_an_episode_ends_on_a_slope(sim: str, direction: str) -> None:
    ramp = {"name": "ramp", "direction": direction, "length": 2.0}
    slope = {"slope": 20, "back": False}
    episode = {**EXACT, "run_up": -0.6, "run_out": -0.7}
    env = FlipperEnv({**ramp, **slope}, sim=sim, episode=episode)
    env.reset(seed=1)
    ended = False
    while not ended:
        *_, ended, _, info = env.step(HOLD)
    assert info["outcome"] is Outcome.REACHED
    assert env.state.position[0] == pytest.approx(env.profile.end - 0.7, abs=0.01)
    assert abs(env.state.pitch) == pytest.approx(ANGLE, abs=0.02)


@pytest.mark.parametrize("occlusion", [False, True])
def test_ground_far_inside_the_obstacle_is_sensed_as_it_is(occlusion: bool) -> None:
    ramp = {"name": "ramp", "direction": "up", "length": 10.0}
    slope = {"slope": 20, "back": False}
    inside = {**EXACT, "run_up": -4.0, "run_out": -4.0}  # both farther than any sensor reaches
    exact = {"occlusion": occlusion}
    env = FlipperEnv({**ramp, **slope}, episode=inside, perception=exact)
    env.reset(seed=1)
    points = env.perception.points + env.state.position
    assert (np.diff(points[:, 0]) >= 0).all()
    assert points[:, 1] == pytest.approx(env.profile.heights(points[:, 0]))
    wrong = FlipperEnv({**ramp, **slope}, episode=inside, perception={**exact, "map_error": 0.01})
    observation, _ = wrong.reset(seed=1)
    assert np.isfinite(observation).all()


def test_a_robot_that_stands_up_has_not_reached_the_finish() -> None:
    finish = finish_of(UP, Robot(), Episode(run_out=-1.0))
    limits = Limits(angle=math.pi / 3, half=HALF, **finish._asdict())
    height = 3.1 * math.tan(ANGLE) + RADIUS / math.cos(ANGLE)
    assert limits.reached(3.1, height, ANGLE)
    assert not limits.reached(3.1, height + 0.11, ANGLE)


def test_a_finish_where_no_robot_can_stand_is_named() -> None:
    cliff = Profile([(0.0, 0.0), (3.0, 0.0), (3.0, -3.0), (6.0, -3.0)])
    with pytest.raises(TerrainError, match=r"cannot stand 2\.95 m before the last edge"):
        finish_of(cliff, Robot(), Episode(run_out=-2.95))
    x, pose = nearest_rest(cliff, Robot(), 3.05, (0.0, 0.0), math.pi / 3)
    assert pose is not None
    assert x == pytest.approx(2.95)  # its centre of mass is not past the edge
    own = Profile(cliff.points, run_out=-2.95)
    assert finish_of(own, Robot(), Episode()).x == x
    steep = Profile([(0.0, 0.0), (0.05, 0.0), (0.05, -3.0), (1.0, -0.4)])
    x, pose = nearest_rest(steep, Robot(), 1.0, (0.0, 0.0), 0.1)
    assert (x, pose is not None) == (0.0, True)  # before the edge, the farthest place of all
    mirrored = Profile([(0.0, -0.4), (0.95, -3.0), (0.95, 0.0), (1.0, 0.0)])
    assert nearest_rest(mirrored, Robot(), 0.0, (0.0, 0.0), 0.1)[0] == 1.0
    for degrees, farther in ((40.0, False), (50.0, True)):  # at most 45°, whatever overturns it
        x, _ = nearest_rest(slope(degrees), Robot(), 2.0, (0.0, 0.0), math.pi / 3)
        assert (abs(x - 2.0) > 1.0) == farther


@pytest.fixture
def chosen() -> Iterator[str]:
    """Register ground that starts and finishes on itself."""

    @terrain("chosen")
    class Chosen(Terrain):
        """A slope of 4 m."""

        run_up: float = -1.0

        def generate(self, rng: np.random.Generator) -> Profile:
            return Profile(UP.points, run_up=self.run_up, run_out=-1.5)

    yield "chosen"
    del registry["terrain", "chosen"]


def test_a_ground_chooses_its_start_and_finish(chosen: str) -> None:
    env = FlipperEnv(chosen, episode=EXACT)
    env.reset(seed=0)
    assert env.state.position[0] == pytest.approx(1.0)
    assert env.state.pitch == pytest.approx(ANGLE, abs=1e-4)
    assert env.scene.start == 1.0
    assert env.drive.termination.finish == 2.5
    with pytest.raises(TerrainError, match=r"run_up is -7 m; -4 m to 10 m is allowed"):
        FlipperEnv({"name": chosen, "run_up": -7.0}).reset(seed=0)
    with pytest.raises(ValueError, match="run_out is a finite number"):
        Profile(UP.points, run_out=math.nan)


@pytest.mark.parametrize("run_out", [0.0, 0.5])
def test_past_a_face_down_the_finish_is_on_the_lower_level(run_out: float) -> None:
    drop = Profile([(0.0, 0.0), (1.0, 0.0), (1.0, -0.5)])
    finish = finish_of(drop, Robot(), Episode(run_out=run_out))
    assert finish.top == pytest.approx(-0.5 + RADIUS + CLEARANCE)


def test_level_ground_far_from_the_edges_carries_a_robot() -> None:
    """Reward terms and measures see the ground under a robot that starts or ends far away."""
    profile = Profile([(0.0, 0.0), (0.0, 0.2), (1.0, 0.2)])
    for x, z in ((-900.0, 0.0), (-9.0, 0.0), (10.5, 0.2), (30.0, 0.2)):
        found = profile.around(x, 1.0, far=True)
        assert found[0, 0] <= x - 0.9
        assert found[-1, 0] >= x + 0.9
        assert (found[:, 1] == z).all()
        assert np.diff(found[:, 0]) == pytest.approx(0.02)
        in_arrays = profile.around_each(np.array([0.5, x]), 1.0, far=True)
        assert np.array_equal([column[1, : len(found)] for column in in_arrays], found.T)


def test_a_robot_that_passes_the_finish_on_raised_flippers_finishes_past_the_last_edge() -> None:
    valley = Profile([(0.0, 0.0), (2.0, 0.0), (2.0, 0.4), (3.0, 0.4)], run_out=-2.0)
    finish = finish_of(valley, Robot(), Episode())
    limits = Limits(angle=math.pi / 3, half=HALF, **finish._asdict())
    on_top = 0.4 + RADIUS
    assert not limits.reached(2.9, on_top, 0.0)  # the ground has risen past the finish
    assert limits.reached(3.1, on_top, 0.0)
    assert not limits.reached(3.1, on_top + CLEARANCE, 0.1)
