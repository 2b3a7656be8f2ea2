"""What the side plane cannot show; ``tests/sim/test_physics.py`` has the rest."""

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from flipperctl.api import EndingWorld, Outcome, Profile, Robot, Start
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import NonFiniteError
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.mujoco.world import MujocoWorld

FLAT = Profile([(0.0, 0.0)])
STILL = Robot(track_speed=1e-9)
"""A robot whose belts brake, at the smallest speed that the settings allow."""


def place(
    profile: Profile = FLAT,
    robot: Robot | None = None,
    x: float = 0.0,
    *angles: float,
    **sim: float,
) -> MujocoWorld:
    start = Start(x, *angles)
    return Mujoco(**sim).place(profile, robot or Robot(), start, np.random.default_rng(0))


def test_rests_on_its_tracks_with_the_mass_of_the_robot() -> None:
    world = place(robot=STILL)
    world.advance(100)
    assert (world.roll, world.yaw) == pytest.approx((0.0, 0.0), abs=1e-4)
    # 35 kg and two pairs of 5 kg, each of which is two flippers of 2.5 kg
    assert world.model.body_mass[1:].tolist() == [35.0, 2.5, 2.5, 2.5, 2.5]
    pushed = world.data.efc_force[world.data.contact.efc_address]
    assert pushed.sum() == pytest.approx(45 * 9.81, rel=0.01)


# Sideways, the outermost contacts lie 0.266 + 0.18/2 = 0.356 m beside the centre and the centre of
# gravity 0.1 m above the ground: it tips at atan(0.356 / 0.1) = 74.3°, long after it slides.
# On its flippers' tips, turned down by π/3, the chassis is 0.1 + 0.336 · sin(π/3) = 0.391 m high
# and the flippers' middle 0.1 + 0.168 · sin(π/3) = 0.2455 m: 0.3587 m for all 45 kg, which tip at
# atan(0.356 / 0.3587) = 44.8°.
@pytest.mark.parametrize(("degrees", "tips"), [(42.0, False), (47.0, True)])
def test_tips_sideways_on_its_tips_where_statics_says(degrees: float, tips: bool) -> None:
    down = -math.pi / 3
    world = place(FLAT, STILL, 0.0, down, down, friction=3.0)
    world.model.opt.gravity[:] = (
        0.0,
        -9.81 * math.sin(math.radians(degrees)),
        -9.81 * math.cos(math.radians(degrees)),
    )
    world.advance(200)
    assert (world.ended() is Outcome.OVERTURNED) is tips


def test_flippers_yield_at_their_torque() -> None:
    weak = place(robot=Robot(flipper_torque=20.0))
    weak.command(0.0, -0.8)
    weak.advance(300)
    # 20 N m on the hinge carry 20 / 0.336 = 60 N of the robot's 441 N
    assert weak.state().rear == pytest.approx(0.0, abs=0.02)


def test_the_work_of_the_flippers_is_that_of_their_mean_torque() -> None:
    """At its limit, a servo turns its torque from substep to substep."""
    found = []
    for substep in (0.005, 0.001):
        world = place(FLAT, Robot(), -1.0, 0.0, 0.0, substep=substep)
        world.advance(50)
        for front in (0.8, -0.1, 0.8, 0.0):
            world.command(front, 0.0)
            world.advance(250)
        found.append(world.flipper_work())
    assert found[0] == pytest.approx(found[1], rel=0.15)


def test_a_diverged_simulation_is_an_error_and_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    world = place()
    world.data.qvel[2] = math.inf
    with pytest.raises(NonFiniteError, match="sim=mujoco diverged before time"):
        world.advance(5)
    assert not list(tmp_path.iterdir())


def test_rays_end_on_the_ground_and_pass_through_the_robot() -> None:
    step = Profile([(0.0, 0.0), (0.0, 0.2), (2.0, 0.2)])
    directions = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    origin = np.array([-1.0, 0.1, 0.15])  # within the robot, 0.05 m above its centre
    before, cast = (place(step, Robot(), -1.0) for _ in range(2))
    at_start = cast.cast_rays(origin, directions, 3.0)
    assert at_start == pytest.approx([0.15, 1.0, math.inf], abs=1e-9)
    cast.advance(10)
    assert cast.cast_rays(origin, directions, 3.0) == pytest.approx(at_start)
    assert cast.cast_rays(origin, directions, 0.9)[1] == math.inf  # beyond the reach
    before.advance(10)
    assert before.save()[0].tolist() == cast.save()[0].tolist()  # rays leave the physics alone


def test_mujoco_has_the_inertia_of_the_load() -> None:
    robot = Robot(payload=5.0, payload_x=0.4, payload_z=0.2)
    bare, loaded = (place(robot=one).model.body("chassis") for one in (Robot(), robot))
    assert loaded.mass == pytest.approx(40.0)
    assert loaded.ipos == pytest.approx([0.05, 0.0, 0.025])
    # Principal moments do not depend on axes: their sum grows by twice the load's.
    assert loaded.inertia.sum() - bare.inertia.sum() == pytest.approx(2 * sum(robot.load_inertia))
    turned = np.zeros(9)
    mujoco.mju_quat2Mat(turned, np.array(loaded.iquat))
    axes = turned.reshape(3, 3)
    tensor = axes @ np.diag(loaded.inertia) @ axes.T
    assert tensor[0, 2] == pytest.approx(-(35 * 5 / 40) * 0.4 * 0.2)


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
    # With a friction of 0.1 it slides down, to the right.
    slides = place(lateral_slope=0.2, friction=0.1)
    slides.advance(100)
    assert slides.state().side < -0.2


def test_a_roll_ends_as_overturned() -> None:
    env = FlipperEnv("flat", sim={"name": "mujoco", "lateral_slope": 0.2, "roll_limit": 0.1})
    env.reset(seed=0)
    *_, terminated, truncated, info = env.step(4)
    assert (info["outcome"], terminated, truncated) == (Outcome.OVERTURNED, True, False)


def test_leaving_the_ground_sideways_ends_as_overturned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flipperctl.sim.mujoco.world.GROUND_WIDTH", 1.0)
    world = place(heading_gain=0.0)
    assert isinstance(world, EndingWorld)
    turn(world, 0.7)
    assert world.ended() is None
    assert len(world.advance(1000)) < 1000
    assert world.state().side > 0.5
    assert world.ended() is Outcome.OVERTURNED


def lateral(env: FlipperEnv, seed: int) -> tuple[float, float, list[float]]:
    """Return yaw, sideways position and heights of the ground at the start of an episode."""
    env.reset(seed=seed)
    world = env.drive.world.of_engine
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
