"""Walls and posts beside the way: seen by rays, felt by nothing."""

import math

import numpy as np
import pytest

from flipperctl.api import Profile, Robot, Start
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.mujoco.world import MujocoWorld

STEP = Profile([(0.0, 0.0), (0.0, 0.1), (2.0, 0.1)])
SIDEWAYS = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])


def place(**sim: object) -> MujocoWorld:
    engine = Mujoco(roughness=0.02, yaw=0.3, **sim)  # type: ignore[arg-type]
    world = engine.place(STEP, Robot(), Start(-0.8), np.random.default_rng(4))
    assert isinstance(world, MujocoWorld)
    return world


@pytest.mark.parametrize("scenery", ["walls", "posts"])
def test_the_motion_is_equal_bit_for_bit_without_the_scenery(scenery: str) -> None:
    # As near as possible: the robot, which is 0.36 m wide to each side, drives through its edge.
    worlds = [place(), place(scenery=scenery, scenery_distance=0.5)]
    for world in worlds:
        world.command(0.5, -0.3)
    assert np.array_equal(*(world.advance(400) for world in worlds))
    assert np.array_equal(*(world.data.qvel for world in worlds))


def test_rays_end_at_walls() -> None:
    origin = np.array([-1.0, 0.2, 0.5])
    assert place().cast_rays(origin, SIDEWAYS, 9.0)[:2] == pytest.approx([math.inf, math.inf])
    found = place(scenery="walls", scenery_distance=1.5).cast_rays(origin, SIDEWAYS, 9.0)
    assert found == pytest.approx([1.3, 1.7, 0.5], abs=0.021)  # rough ground below


def test_posts_stand_at_irregular_places_on_both_sides() -> None:
    angles = np.radians(np.arange(0.0, 360.0, 0.5))
    around = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
    found = place(scenery="posts").cast_rays(np.array([0.0, 0.0, 1.0]), around, 9.0)
    hit = np.isfinite(found)
    y = found[hit] * around[hit, 1]
    assert (np.abs(y) >= 1.5 - 1e-9).all()
    assert (y > 0).any()
    assert (y < 0).any()
    assert 0.05 < hit.mean() < 0.6
