"""The compiled loop against the same numbers through MuJoCo's Python functions."""

import math

import mujoco
import numpy as np
import pytest

from flipperctl.api import FloatArray, Profile, Robot, Start
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.mujoco.world import MujocoWorld

STEP = Profile([(0.0, 0.0), (0.0, 0.15), (0.5, 0.15)])
SLOPE = 0.1  # sideways [rad]
TARGETS = 0.4, -0.2  # of the front and the rear flippers [rad]


def place(robot: Robot, gain: float) -> MujocoWorld:
    """Return a robot ahead of a step, turned and beside the middle."""
    sim = Mujoco(yaw=0.3, offset=0.2, heading_gain=gain, lateral_slope=SLOPE, substep=0.0025)
    return sim.place(STEP, robot, Start(-0.7), np.random.default_rng(3))


def axes(pose: list[float]) -> FloatArray:
    """Return the rotation from frame R to world, (3, 3)."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, np.array(pose[3:7]))
    return turn.reshape(3, 3)


def plain(world: MujocoWorld, robot: Robot, gain: float, share: float) -> list[list[float]]:
    """Return 60 poses, with servos' work and roll variation after each, in steps of Python."""
    model, data = world.model, world.data
    still, sides = model.geom_surfacevel.copy(), np.zeros(model.ngeom)
    for part in range(model.ngeom):
        name = model.geom(part).name
        sides[part] = name.endswith("left") - 1.0 * name.endswith("right")
    poses, work, rolled = [], 0.0, 0.0
    for _ in range(60):
        before = data.qpos.tolist()
        ahead, across = axes(before)[:, 0], axes(before)[:, 1]
        for i, target in enumerate(2 * TARGETS):
            speed = 25.0 * (target - before[7 + i])
            data.ctrl[i] = min(robot.flipper_speed, max(-robot.flipper_speed, speed))
        if gain:
            steer = gain * (math.atan2(ahead[1], ahead[0]) + before[1])
            steer = min(0.5, max(-0.5, steer))
            model.geom_surfacevel[:] = share * still * (1.0 + steer * sides[:, None])
        torques = np.zeros(4)
        for _ in range(4):
            mujoco.mj_step(model, data)
            torques += data.actuator_force
        pose = data.qpos.tolist()
        work += float(np.abs(torques / 4 * (data.qpos[7:11] - before[7:11])).sum())
        up = np.array([0.0, math.sin(SLOPE), math.cos(SLOPE)])
        rolled += abs(math.asin(axes(pose)[:, 1] @ up) - math.asin(across @ up))
        rise = axes(pose)[:, 0] @ up
        angles = (pose[7] + pose[9]) / 2, (pose[8] + pose[10]) / 2
        poses.append([pose[0], pose[2], math.asin(rise), *angles, work, rolled])
    return poses


@pytest.mark.parametrize(("gain", "share"), [(2.0, 1.0), (2.0, 0.5), (0.0, 1.0)])
def test_does_what_a_loop_in_python_does(gain: float, share: float) -> None:
    robot = Robot()
    compiled, stepped = place(robot, gain), place(robot, gain)
    compiled.command(*TARGETS)
    compiled.run_belts(share)
    expected = plain(stepped, robot, gain, share)
    poses = [
        [*compiled.advance(1)[0], compiled.flipper_work(), compiled.roll_variation()]
        for _ in range(60)
    ]
    # The rotation of MuJoCo's library may differ in its last bit.
    assert poses == pytest.approx(np.array(expected), abs=1e-9)
