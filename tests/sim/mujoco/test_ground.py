"""The extruded ground: its boxes fill what lies below the profile and nothing above it."""

import math

import numpy as np
import pytest

from flipperctl.api import Profile, registry
from flipperctl.errors import TerrainError
from flipperctl.sim.mujoco import Mujoco, ground
from flipperctl.sim.mujoco.ground import Box, boxes

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


@pytest.mark.parametrize("height", [0.2, -0.2])
def test_a_single_step_on_the_left_alone_is_an_incline_on_the_right(height: float) -> None:
    found = made(Profile([(0, 0), (0, height)]), one_sided=1.0)
    for x, left, right in ((-0.5, 0.0, 0.0), (0.5, 1.0, 0.5), (0.75, 1.0, 0.75), (1.5, 1.0, 1.0)):
        assert surface(found, x, 0.3) == pytest.approx(left * height)
        assert surface(found, x, -0.3) == pytest.approx(right * height)
    half = made(Profile([(0, 0), (0, height)]), one_sided=0.5)  # a step of half the height
    assert surface(half, 0.001, -0.3) == pytest.approx(0.5 * height, abs=1e-3)
    assert surface(half, 0.5, -0.3) == pytest.approx(0.75 * height)


@pytest.mark.parametrize("name", [name for name in TERRAINS if name != "flat"])
def test_every_obstacle_can_stand_on_the_left_alone(name: str) -> None:
    profile = registry["terrain", name]().generate(np.random.default_rng(2))
    found = made(profile, one_sided=1.0)
    (x0, z0), (x1, z1) = profile.points[0], profile.points[-1]
    x = np.linspace(x0 - 0.5, max(x1, x0 + 1.0) + 0.5, 61) + 1e-3
    heights = np.array([profile.height(at) for at in x])
    clear = [np.abs(profile.points[:, 0] - at).min() > 0.011 for at in x]  # as above
    left, right = (np.array([surface(found, at, y) for at in x]) for y in (0.3, -0.3))
    assert left[clear] == pytest.approx(heights[clear], abs=1e-6)
    assert right == pytest.approx(np.interp(x, (x0, max(x1, x0 + 1.0)), (z0, z1)), abs=1e-6)
    assert np.abs(left - right).max() > 0.05


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
