"""The 3-D engine beyond the plane; ``tests/sim/test_physics.py`` has the physics of both."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from flipperctl.api import Limits, Outcome, Profile, Robot, Start
from flipperctl.config import resolver
from flipperctl.errors import MissingExtraError, NonFiniteError
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.mujoco.world import MujocoWorld
from flipperctl.sim.resting import OVERLAP
from tests.cli.call import call

FLAT = Profile([(0.0, 0.0)])
STILL = 1e-9  # [m/s] belts that brake: the smallest speed that the settings allow


def place(profile: Profile, robot: Robot, x: float, *angles: float, **sim: float) -> MujocoWorld:
    world = Mujoco(**sim).place(profile, robot, Start(x, *angles), np.random.default_rng(0))
    assert isinstance(world, MujocoWorld)
    return world


def run(world: MujocoWorld, seconds: float) -> None:
    world.advance(round(100 * seconds))


def test_rests_on_its_tracks_with_the_mass_of_the_robot() -> None:
    world = place(FLAT, Robot(track_speed=STILL), 0.0)
    run(world, 1.0)
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
    robot = Robot(track_speed=STILL)
    world = place(FLAT, robot, 0.0, down, down, friction=3.0)
    world.model.opt.gravity[:] = (
        0.0,
        -9.81 * math.sin(math.radians(degrees)),
        -9.81 * math.cos(math.radians(degrees)),
    )
    run(world, 2.0)
    assert (world.ended() is Outcome.OVERTURNED) is tips


def test_flippers_turn_at_their_rate_and_yield_at_their_torque() -> None:
    world = place(FLAT, Robot(), 0.0)
    world.command(0.8, -0.5)
    poses = world.advance(150)
    # 25 °/s for 1 s is 0.436 rad; the front pair lifts itself, the rear pair the robot
    assert poses[99, 3:] == pytest.approx([0.436, -0.436], abs=0.02)
    weak = place(FLAT, Robot(flipper_torque=20.0), 0.0)
    weak.command(0.0, -0.8)
    weak.advance(300)
    # 20 N m on the hinge carry 20 / 0.336 = 60 N of the robot's 441 N
    assert weak.state().rear == pytest.approx(0.0, abs=0.02)


def test_equal_inputs_give_bit_identical_trajectories_and_snapshots_continue_them() -> None:
    stair = resolver.create("terrain", "paper_stair", "terrain").generate(np.random.default_rng(0))

    def trajectory(*, interrupted: bool) -> np.ndarray:
        world = place(stair, Robot(), -1.0, yaw=0.05, roughness=0.01)
        poses = []
        for decision in range(20):
            world.command(0.8 * math.sin(decision), 0.8 * math.cos(decision))
            if interrupted and decision == 9:
                saved = world.save()
                run(world, 1.0)
                world.load(saved)
            poses.append(world.advance(60))
        return np.concatenate(poses)

    first = trajectory(interrupted=False)
    assert np.array_equal(first, trajectory(interrupted=False))
    assert np.array_equal(first, trajectory(interrupted=True))
    assert first[-1, 0] > 0.0  # it got as far as the stairs


def test_the_work_of_the_flippers_is_that_of_their_mean_torque() -> None:
    """At its limit, a servo turns its torque from substep to substep."""
    found = []
    for substep in (0.005, 0.001):
        world = place(FLAT, Robot(), -1.0, 0.0, 0.0, substep=substep)
        run(world, 0.5)
        for front in (0.8, -0.1, 0.8, 0.0):
            world.command(front, 0.0)
            run(world, 2.5)
        found.append(world.flipper_work())
    assert found[0] == pytest.approx(found[1], rel=0.15)


def test_a_large_robot_starts_beside_rough_ground() -> None:
    """Shifted ahead, the tips of its flippers would stand on a patch before the first edge."""
    robot = Robot(flipper_length=0.59, chassis_length=0.83)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        ground = Profile([(0.0, 0.0), (0.0, 0.1), (1.0, 0.1)])
        world = Mujoco(roughness=0.015, yaw=0.05).place(ground, robot, Start(-0.9), rng)
        assert world.penetration() <= OVERLAP
        assert float(world.position[0]) > -1.25


def test_stops_at_the_sample_that_reaches_a_limit() -> None:
    world = place(FLAT, Robot(), 0.0)
    poses = world.advance(200, Limits(x=0.05))
    assert poses[-2, 0] < 0.05 <= poses[-1, 0]
    assert world.time == pytest.approx(0.01 * len(poses))


def test_a_diverged_simulation_is_an_error_and_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    world = place(FLAT, Robot(), 0.0)
    world.data.qvel[2] = math.inf
    with pytest.raises(NonFiniteError, match="sim=mujoco diverged before time"):
        world.advance(5)
    assert not list(tmp_path.iterdir())


def test_without_mujoco_the_error_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'flipperctl\[mujoco\]'"):
        Mujoco().place(FLAT, Robot(), Start(0.0), np.random.default_rng(0))
    asked = ["eval", "--controller", "level", "sim=mujoco", "terrain=step", "--episodes", "1"]
    done = call(*asked, cwd=tmp_path)
    assert done.code == 2
    assert "pip install 'flipperctl[mujoco]'" in done.err


def test_rays_end_on_the_ground_and_pass_through_the_robot() -> None:
    step = Profile([(0.0, 0.0), (0.0, 0.2), (2.0, 0.2)])
    directions = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    origin = np.array([-1.0, 0.1, 0.15])  # within the robot, 0.05 m above its centre
    before, cast = (place(step, Robot(), -1.0) for _ in range(2))
    at_start = cast.cast_rays(origin, directions, 3.0)
    assert at_start == pytest.approx([0.15, 1.0, math.inf], abs=1e-9)
    run(cast, 0.1)
    assert cast.cast_rays(origin, directions, 3.0) == pytest.approx(at_start)
    assert cast.cast_rays(origin, directions, 0.9)[1] == math.inf  # beyond the reach
    run(before, 0.1)
    assert before.save()[0].tolist() == cast.save()[0].tolist()  # rays leave the physics alone
