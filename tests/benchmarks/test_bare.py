"""Chipmunk alone drives like the world for as long as the ground is level."""

import numpy as np
import pytest

from benchmarks import bare
from flipperctl.api import Profile, Robot, Start
from flipperctl.sim.planar import Planar
from flipperctl.sim.planar.world import PlanarWorld

LEVEL = Profile([(0, 0), (1, 0)])


def world() -> PlanarWorld:
    return PlanarWorld(LEVEL, Robot(), Planar(), Start(-3.0))


def test_a_stripped_world_drives_forward_on_level_ground() -> None:
    stripped = world()
    bare.strip(stripped)
    bare.step(stripped, 1000)  # 5 s at 0.2 m/s
    assert stripped.position[0] == pytest.approx(-2.0, abs=0.02)
    assert bare.contacts(stripped) == 6


def test_a_world_is_put_into_the_state_of_another() -> None:
    driven, stripped = world(), world()
    driven.command(0.3, -0.2)
    for _ in range(50):
        driven.advance()
    snapshot = bare.snapshot(driven)
    assert snapshot.phases == (0.3, 0.2)
    bare.strip(stripped)
    bare.put(stripped, snapshot, snapshot.phases)
    assert bare.snapshot(stripped) == snapshot
    for _ in range(60):
        driven.advance()
    bare.step(stripped, 120)
    assert np.allclose(stripped.position, driven.position, atol=1e-3)
    assert stripped.pitch == pytest.approx(driven.pitch, abs=2e-3)
