"""The extruded ground: its boxes fill what lies below the profile and nothing above it."""

import math

import numpy as np
import pytest

from flipperctl.api import Profile, Robot, Start, registry
from flipperctl.errors import TerrainError
from flipperctl.sim.mujoco import Mujoco, ground
from flipperctl.sim.mujoco.ground import Box, boxes
from flipperctl.sim.mujoco.world import MujocoWorld

TERRAINS = sorted(name for kind, name in registry if kind == "terrain")


def made(profile: Profile, **sim: float) -> list[Box]:
    return boxes(profile, Mujoco(**sim), np.random.default_rng(0))


def surface(found: list[Box], x: float, y: float) -> float:
    """Return the height of the highest box at (x, y) [m]."""
    heights = [-math.inf]
    for (cx, cy, cz), (length, width, thick), tilt in found:
        if abs(y - cy) > width:
            continue
        corners = [
            (
                cx + s * length * math.cos(tilt) - t * thick * math.sin(tilt),
                cz + s * length * math.sin(tilt) + t * thick * math.cos(tilt),
            )
            for s, t in ((-1, 1), (1, 1), (1, -1), (-1, -1))
        ]
        for (x0, z0), (x1, z1) in zip(corners, [*corners[1:], corners[0]], strict=True):
            if min(x0, x1) <= x <= max(x0, x1) and abs(x1 - x0) > 1e-12:
                heights.append(z0 + (z1 - z0) * (x - x0) / (x1 - x0))
    return max(heights)


# The board below the last facet of a sharp ridge sticks out by less than its thickness of 10 mm,
# which is up to 10 mm / cos(slope) measured upwards.
@pytest.mark.parametrize("name", TERRAINS)
@pytest.mark.parametrize("seed", [0, 1])
def test_the_boxes_surface_is_the_profile(name: str, seed: int) -> None:
    profile = registry["terrain", name]().generate(np.random.default_rng(seed))
    found = made(profile)
    faces = profile.points[:, 0]
    for x in np.arange(profile.start - 0.5, profile.end + 0.5, 0.0371):
        if np.abs(faces - x).min() < 0.011:
            continue  # at a face the height is not unique, at a ridge boards may stick out
        assert surface(found, x, 0.1) == pytest.approx(profile.height(x), abs=1e-6)


def test_a_stair_is_one_box_for_each_tread() -> None:
    stair = Profile([(0, 0), (0, 0.2), (0.3, 0.2), (0.3, 0.4), (0.6, 0.4), (0.6, 0.0)])
    assert len(made(stair)) == 4  # two treads, and the ground before and past them


def test_a_face_below_a_slope_is_a_board_of_its_own() -> None:
    # The tread behind the face is tilted, so that no column's side is the face.
    found = made(Profile([(0, 0), (0, 0.2), (0.5, 0.3), (0.5, 0.0)]))
    (face,) = (box for box in found if box.tilt == pytest.approx(math.pi / 2))
    (x, _, z), (length, width, thick), _ = face
    assert (x - thick, z, length, width) == pytest.approx((0.0, 0.1, 0.1, 2.0))


def test_a_sharp_ridge_gets_the_thinnest_boards() -> None:
    found = made(Profile([(0, 0), (0.1, 0.3), (0.2, 0.0)]))
    assert [box.half[2] for box in found if box.tilt] == [0.005, 0.005]


def test_one_sided_obstacles_are_missing_on_the_right() -> None:
    block = Profile([(0, 0), (0, 0.2), (0.5, 0.2), (0.5, 0.0)])
    for fraction, right in ((1.0, 0.0), (0.25, 0.15)):
        found = made(block, one_sided=fraction)
        assert surface(found, 0.25, 0.3) == pytest.approx(0.2)
        assert surface(found, 0.25, -0.3) == pytest.approx(right)
    riser = Profile([(0, 0), (0, 0.2)])  # there is no line between its ends
    assert surface(made(riser, one_sided=1.0), 1.0, -0.3) == pytest.approx(0.2)


def test_roughness_shifts_patches_over_the_obstacle_alone() -> None:
    found = made(Profile([(0, 0), (2.0, 0)]), roughness=0.03)
    inside = [surface(found, x, y) for x in (0.3, 1.0, 1.7) for y in (-0.5, 0.1, 0.5)]
    assert len(set(inside)) == 9
    assert max(map(abs, inside)) <= 0.03
    beside = [surface(found, x, y) for x, y in ((-1.0, 0.1), (3.0, 0.1), (1.0, 1.5))]
    assert beside == pytest.approx([0.0, 0.0, 0.0])


def test_too_many_boxes_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ground, "MOST", 5)
    with pytest.raises(TerrainError, match="needs more than 5 boxes"):
        made(Profile([(0, 0), (2.0, 0)]), roughness=0.01)


@pytest.mark.parametrize("setting", ["yaw", "offset", "roughness"])
def test_the_variation_is_drawn_anew_for_each_start_and_repeats(setting: str) -> None:
    sim = Mujoco(**{setting: 0.1})

    def begin(x: float, engine: Mujoco = sim) -> list[float]:
        world = engine.place(Profile([(0, 0), (1.0, 0)]), Robot(), Start(x))
        assert isinstance(world, MujocoWorld)
        return [world.yaw, *world.data.qpos[:2], *world.model.geom_pos[:, 2]]

    assert begin(-1.0) == begin(-1.0)
    assert begin(-1.0)[3:] + begin(-1.0)[:1] != begin(-1.01)[3:] + begin(-1.01)[:1] or (
        begin(-1.0)[2] != begin(-1.01)[2]
    )
    assert begin(-1.0) != begin(-1.0, Mujoco(**{setting: 0.1}, variation=1))
