"""The contract of both engines' physics, against numbers worked by hand."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pymunk
import pytest

from flipperctl.api import Engine, FloatArray, Limits, Profile, Robot, Start
from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.sim.ground import resting
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.mujoco.world import MujocoWorld
from flipperctl.sim.planar import Planar
from flipperctl.sim.planar.world import PlanarWorld

FLAT = Profile([(0.0, 0.0)])
STILL = 1e-9  # [m/s] belts that brake: the smallest speed that the settings allow


def turn_planar(world: PlanarWorld, angle: float, lift: float) -> None:
    """Turn the whole robot nose up about the ground below its centre, then lift it."""
    x, _ = world.position
    pivot = pymunk.Vec2d(x, world.profile.height(x))
    for body in world.space.bodies:
        body.position = pivot + (body.position - pivot).rotated(angle) + (0.0, lift)
        body.angle += angle


def turn_mujoco(world: MujocoWorld, angle: float, lift: float) -> None:
    """Do the same in three dimensions."""
    pose = world.data.qpos
    height = pose[2] - world.profile.height(float(pose[0]))
    pose[0] -= height * math.sin(angle)
    pose[2] += height * (math.cos(angle) - 1) + lift
    pose[3:7] = math.cos(angle / 2), 0.0, -math.sin(angle / 2), 0.0


def energy_planar(world: PlanarWorld) -> float:
    """Return the robot's kinetic and potential energy, 0 at z = 0 [J]."""
    return sum(
        body.mass * 9.81 * body.position.y
        + body.mass * body.velocity.length**2 / 2
        + body.moment * body.angular_velocity**2 / 2
        for body in world.space.bodies
    )


def energy_mujoco(world: MujocoWorld) -> float:
    """Return the robot's kinetic and potential energy, 0 at z = 0 [J]."""
    model, data = world.model, world.data
    mujoco.mj_forward(model, data)
    mujoco.mj_energyPos(model, data)
    mujoco.mj_energyVel(model, data)
    return float(data.energy.sum())


@dataclass(frozen=True)
class Case:
    """An engine, what its tests do to its world, and how closely it keeps what is at rest."""

    engine: type[Engine]
    turn: Callable[[Any, float, float], None]
    energy: Callable[[Any], float]
    rests: float
    """Largest error of a height at rest [m]."""
    creeps: float
    """Largest way in 2 s of holding on a slope [m]."""
    balances: float
    """Largest pitch on the brink [rad]."""

    @property
    def name(self) -> str:
        return self.engine.plugin_name

    def place(self, profile: Profile, robot: Robot, x: float, *angles: float, **sim: float) -> Any:
        start = Start(x, *angles)
        return self.engine(**sim).place(profile, robot, start, np.random.default_rng(0))

    def on_slope(self, degrees: float, friction: float) -> Any:
        """Return a braking robot that stands on a slope of 120 m length."""
        slope = math.radians(degrees)
        rise = 60.0 * math.tan(slope)
        ground = Profile([(-60.0, -rise), (60.0, rise)])
        world = self.place(ground, Robot(track_speed=STILL), 0.0, friction=friction)
        self.turn(world, slope, 0.0)
        world.advance(50)
        return world


PLANAR = Case(Planar, turn_planar, energy_planar, rests=2e-4, creeps=1e-3, balances=1e-3)
MUJOCO = Case(Mujoco, turn_mujoco, energy_mujoco, rests=5e-4, creeps=2e-3, balances=5e-3)


@pytest.fixture(params=[PLANAR, MUJOCO], ids=lambda case: case.name)
def case(request: pytest.FixtureRequest) -> Case:
    return request.param


LEANS = math.radians(25)
SLOPE = Profile([(0.0, 0.0), (14.0, 14.0 * math.tan(LEANS))])
NEEDED = 45 * 9.81 * math.sin(LEANS)
"""Force that holds the robot on that slope [N]."""


def resting_on_slope(case: Case, **robot: Any) -> Any:
    """Return a robot of these settings that drives on a slope of 25°."""
    placed = Robot(**robot)
    pose = resting(SLOPE, placed, 7.0, 0.0, 0.0, 1.0)
    assert pose is not None
    start = Start(7.0, height=pose[0], pitch=pose[1])
    world = case.engine().place(SLOPE, placed, start, np.random.default_rng(0))
    world.command(0.0, 0.0)
    return world


def episode(env: FlipperEnv) -> dict:
    """Return the last info of an episode under the rule controller."""
    rule = resolver.create("controller", "okada", "controller").build()
    env.reset(seed=0)
    while True:
        *_, terminated, truncated, info = env.step(rule.act(env.perception))
        if terminated or truncated:
            return info


def crossing(height: float, **sim: object) -> str:
    """Return the outcome of the rule controller at one riser."""
    terrain = {"name": "step", "height": height}
    return episode(FlipperEnv(terrain=terrain, sim=sim, episode={"start_noise": 0}))["outcome"]


@pytest.mark.parametrize("speed", [0.05, 1.0])
def test_drives_at_the_belt_speed_on_the_flat(speed: float, case: Case) -> None:
    world = case.place(FLAT, Robot(track_speed=speed), -5.0)
    world.advance(100)  # it starts at rest
    start = world.position[0]
    world.advance(500)
    assert (world.position[0] - start) / 5.0 == pytest.approx(speed, rel=0.01)


def test_rests_at_the_height_of_its_tracks(case: Case) -> None:
    world = case.place(FLAT, Robot(track_speed=STILL), 0.0)
    world.advance(100)
    assert tuple(world.position) == pytest.approx((0.0, 0.1), abs=case.rests)
    assert world.pitch == pytest.approx(0.0, abs=1e-4)


# atan 0.5 = 26.57°
@pytest.mark.parametrize("degrees", [20.0, 25.0])
def test_holds_on_a_slope_below_the_angle_of_friction(degrees: float, case: Case) -> None:
    world = case.on_slope(degrees, friction=0.5)
    before = np.array(world.position)
    world.advance(200)
    assert np.linalg.norm(np.array(world.position) - before) < case.creeps
    assert math.degrees(world.pitch) == pytest.approx(degrees, abs=0.1)


# g (sin a - 0.5 cos a): 9.81 · (0.46947 - 0.44147) = 0.2747, 9.81 · (0.52992 - 0.42402) = 1.0388
@pytest.mark.parametrize(("degrees", "acceleration"), [(28.0, 0.2747), (32.0, 1.0388)])
def test_slides_on_a_slope_above_the_angle_of_friction(
    degrees: float, acceleration: float, case: Case
) -> None:
    world = case.on_slope(degrees, friction=0.5)
    downhill = -np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
    before = world.state().velocity @ downhill
    ways = world.advance(100)[:, :2] @ downhill
    gained = world.state().velocity @ downhill - before
    assert case is MUJOCO or gained == pytest.approx(acceleration, rel=0.03)  # in 3-D it rocks
    assert 2 * np.polyfit(0.01 * np.arange(100), ways, 2)[0] == pytest.approx(
        acceleration, rel=0.02
    )


# At the edge of a cliff, the front pair level and the rear pair up at π/3. Seen from the chassis
# centre, a pair's centre of gravity lies 0.28 + 0.168 = 0.448 m ahead and
# 0.28 + 0.168 · cos(π/3) = 0.364 m behind; pairs of m kg and the chassis of 35 kg balance at
# m (0.448 - 0.364) / (35 + 2 m): 9.3 mm ahead for 5 kg, 22.4 mm for 20 kg.
@pytest.mark.parametrize(("mass", "ahead"), [(5.0, 0.0093), (20.0, 0.0224)])
def test_tips_over_an_edge_where_statics_says(mass: float, ahead: float, case: Case) -> None:
    cliff = Profile([(0.0, 0.0), (0.0, -2.0)])
    robot = Robot(track_speed=STILL, flipper_mass=mass)
    pitches = []
    for overhang in (-0.005, 0.005):  # [m] of the centre of gravity beyond the edge
        world = case.place(cliff, robot, overhang - ahead, 0.0, math.pi / 3)
        world.advance(200)
        pitches.append(world.pitch)
    assert pitches[0] == pytest.approx(0.0, abs=case.balances)
    assert pitches[1] < -0.5


# A tilted robot rocks a little when its other end slaps down.
@pytest.mark.parametrize(("tilt", "rebound"), [(0.0, 0.02), (0.3, 0.1)])
def test_a_drop_loses_energy_and_does_not_bounce(tilt: float, rebound: float, case: Case) -> None:
    world = case.place(FLAT, Robot(track_speed=STILL), 0.0)
    case.turn(world, tilt, 0.5)
    energies, heights = [case.energy(world)], []
    for _ in range(200):
        world.advance(1)
        energies.append(case.energy(world))
        heights.append(world.position[1])
    # The planar engine lets bodies in contact sink in by at most one substep's way, here
    # √(2 · 9.81 · 0.5) m/s · 5 ms = 15.7 mm, and pushes them out again: 45 · 9.81 · 0.0157 = 6.9 J
    # of the 45 · 9.81 · 0.5 = 221 J that the drop sets free. Springs of contacts return as much.
    assert max(np.diff(energies)) < 6.9
    assert energies[-1] == pytest.approx(45 * 9.81 * 0.1, rel=0.01)  # at rest on the tracks
    landed = int(np.argmax(np.array(heights) < 0.11))
    assert max(heights[landed:]) < 0.1 + rebound


@pytest.mark.parametrize(("height", "friction"), [(0.2, 0.7), (0.4, 1.0)])
def test_the_belt_climbs_a_riser(height: float, friction: float, case: Case) -> None:
    assert crossing(height, name=case.name, friction=friction) == "reached"


def test_penetration_is_the_depth_in_the_ground(case: Case) -> None:
    world = case.place(FLAT, Robot(), 0.0)
    case.turn(world, 0.0, -0.03)
    assert world.penetration() == pytest.approx(0.03, abs=1e-6)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "terrain"),
    [("planar", "paper_step"), ("planar", "paper_stair"), ("mujoco", "paper_step")],
)
def test_half_the_substep_changes_the_pitch_variation_little(name: str, terrain: str) -> None:
    coarse, fine = (
        episode(FlipperEnv(terrain, sim={"name": name, "substep": s}, episode={"start_noise": 0}))
        for s in (0.005, 0.0025)
    )
    assert coarse["outcome"] == fine["outcome"] == "reached"
    variations = [info["metrics"]["pitch_variation_decisions"] for info in (coarse, fine)]
    assert variations[0] == pytest.approx(variations[1], rel=0.05)


def test_stops_at_the_sample_that_reaches_a_limit(case: Case) -> None:
    world = case.place(FLAT, Robot(), 0.0)
    poses = world.advance(200, Limits(x=0.05))
    assert poses[-2, 0] < 0.05 <= poses[-1, 0]
    assert world.time == pytest.approx(0.01 * len(poses))


def test_equal_inputs_give_bit_identical_trajectories_and_snapshots_continue_them(
    case: Case,
) -> None:
    stair = resolver.create("terrain", "paper_stair", "terrain").generate(np.random.default_rng(0))
    varied = {"yaw": 0.05, "roughness": 0.01} if case is MUJOCO else {}

    def trajectory(*, interrupted: bool) -> FloatArray:
        world = case.place(stair, Robot(), -1.0, **varied)
        poses = []
        for decision in range(20):
            world.command(0.8 * math.sin(decision), 0.8 * math.cos(decision))
            if interrupted and decision == 9:
                saved = world.save()
                world.advance(100)
                world.load(saved)
            poses.append(world.advance(60))
        return np.concatenate(poses)

    first = trajectory(interrupted=False)
    assert np.array_equal(first, trajectory(interrupted=False))
    assert first[-1, 0] > 0.0  # it got as far as the stairs
    again = trajectory(interrupted=True)
    # The plane's snapshots lack contact impulses.
    assert np.abs(again - first)[600].max() < 1e-3
    assert case is PLANAR or np.array_equal(again, first)


# Flippers


@pytest.mark.parametrize("sign", [1, -1])
def test_flippers_turn_at_their_rate_and_stop_at_their_limit(sign: int, case: Case) -> None:
    world = case.place(FLAT, Robot(track_speed=STILL), 0.0)
    target = sign * math.pi / 12
    world.command(target, target)
    poses = world.advance(60)
    # half of 15° / (25 °/s) = 0.6 s: they turn, they do not jump
    assert poses[29, 3:] == pytest.approx([target / 2] * 2, abs=0.02)
    assert poses[59, 3:] == pytest.approx([target] * 2, abs=0.02)
    world.command(sign * 1.5, sign * 1.5)
    assert world.advance(400)[-1, 3:] == pytest.approx([sign * math.pi / 3] * 2, abs=0.02)


# Each pair carries half of 45 kg at 0.336 m, less its own weight at 0.168 m:
# 9.81 · (22.5 · 0.336 - 5 · 0.168) = 65.9 N m. On its tips, the chassis is
# 0.1 + 0.336 sin(π/3) = 0.391 m high.
@pytest.mark.parametrize(("settings", "height"), [({"flipper_torque": 60.0}, 0.1), ({}, 0.391)])
def test_flippers_lift_the_robot_only_with_enough_torque(
    settings: dict[str, float], height: float, case: Case
) -> None:
    world = case.place(FLAT, Robot(track_speed=STILL, **settings), 0.0)
    world.command(-math.pi / 3, -math.pi / 3)
    world.advance(500)
    assert world.position[1] == pytest.approx(height, abs=5e-3)


def test_starts_on_lowered_flippers(case: Case) -> None:
    world = case.place(FLAT, Robot(track_speed=STILL), 0.0, -math.pi / 6, -math.pi / 6)
    assert world.position[1] == pytest.approx(0.1 + 0.336 / 2)  # sin 30° = 1/2
    assert world.penetration() == pytest.approx(0.0, abs=1e-9)


# Loads on the chassis, and the largest force of the tracks


def test_weak_tracks_slide_back_and_strong_ones_climb(case: Case) -> None:
    full = 2.0 * 0.2 * math.cos(LEANS)  # [m]
    strong = resting_on_slope(case, track_force=1.4 * NEEDED).advance(200)
    assert strong[-1, 0] - 7.0 == pytest.approx(full, abs=0.03)
    weak = resting_on_slope(case, track_force=0.8 * NEEDED).advance(200)
    # It slides by half of 0.2 g sin(25°), 0.83 m/s², times the time squared, once it has stopped.
    assert -1.7 < weak[-1, 0] - 7.0 < -0.2


def test_snapshots_keep_loads_and_limits(case: Case) -> None:
    robot = {"track_force": 1.1 * NEEDED, "payload": 8.0, "payload_x": -0.1, "payload_z": 0.3}
    world = resting_on_slope(case, **robot)
    world.advance(20)
    saved, at = world.save(), world.state()
    first = world.advance(20)
    world.load(saved)
    again = world.state()
    assert again.position == pytest.approx(at.position, abs=1e-12)
    assert again.velocity == pytest.approx(at.velocity, abs=1e-12)
    assert np.abs(world.advance(20) - first).max() <= (0.0 if case is MUJOCO else 5e-3)


# 45 kg 0.1 m before the edge are 4.5 kg m; 10 kg 0.25 m ahead of it 2.5, and 25 kg 6.25.
@pytest.mark.parametrize(
    ("load", "tips"),
    [({}, False), ((10.0, 0.35), False), ((25.0, 0.35), True), ((25.0, -0.35), False)],
)
def test_a_load_ahead_of_the_edge_tips_the_robot(load: Any, tips: bool, case: Case) -> None:
    cliff = Profile([(0.0, 0.0), (0.0, -2.0), (3.0, -2.0)])
    robot = Robot(track_speed=1e-6, **dict(zip(("payload", "payload_x"), load, strict=False)))
    world = case.place(cliff, robot, -0.1, 1.0, 1.0)
    world.command(1.0, 1.0)
    pitch = world.advance(100)[-1, 2]
    assert pitch < -0.3 if tips else abs(pitch) < 0.02


def test_masses_of_a_loaded_robot_by_hand() -> None:
    robot = Robot(payload=5.0, payload_x=0.4, payload_z=-0.2)
    assert (robot.carried_mass, robot.mass) == (40.0, 50.0)
    assert robot.centre_of_mass == pytest.approx((0.05, -0.025))
    # 35 kg at 0.05 m and 5 kg at 0.35 m from the centre of mass, and half of both in height.
    ahead = 35 * 0.05**2 + 5 * 0.35**2
    assert robot.load_inertia == pytest.approx((ahead, ahead / 4))
    assert Robot().centre_of_mass == (0.0, 0.0)
    # A robot rests where its load is.
    with_edge, heavy = (
        Profile([(0.0, 0.0), (0.0, -2.0), (3.0, -2.0)]),
        Robot(payload=40.0, payload_x=0.5),
    )
    found = [resting(with_edge, one, -0.1, 1.0, 1.0, 0.5) for one in (Robot(), heavy)]
    assert [pose is None for pose in found] == [False, True]
