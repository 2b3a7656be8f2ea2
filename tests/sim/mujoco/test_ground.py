"""The ground in 3-D: boxes below a profile or along a surface, and what stands beside the way."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flipperctl.api import MirroredSurface, Profile, Robot, Start, Surface, registry
from flipperctl.errors import PluginFailedError, TerrainError
from flipperctl.sim.ground import OVERLAP
from flipperctl.sim.mujoco import Mujoco, ground
from flipperctl.sim.mujoco.ground import Box, lay
from flipperctl.sim.mujoco.world import MujocoWorld

TERRAINS = ["building_stair", "gap", "pallet", "plum", "ramp", "wave"]
X = np.arange(0.0, 3.001, 0.02)
Height = Callable[[np.ndarray, np.ndarray], np.ndarray]


def made(profile: Profile, **sim: float) -> list[Box]:
    return lay(profile, Mujoco(**sim), np.random.default_rng(0)).boxes


def height_at(found: list[Box], x: float, y: float) -> float:
    """Return the height of the highest box at (x, y) [m]."""
    heights = [-math.inf]
    for (cx, cy, cz), (length, width, thick), tilt, _ in found:
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
def test_the_boxes_surface_is_the_profile(name: str) -> None:
    profile = registry["terrain", name]().generate(np.random.default_rng(1))
    found, faces = made(profile), profile.points[:, 0]
    for x in np.arange(profile.start - 0.5, profile.end + 0.5, 0.0371):
        if np.abs(faces - x).min() < 0.011:
            continue  # at a face the height is not unique, at a ridge boards may stick out
        assert height_at(found, x, 0.1) == pytest.approx(profile.height(x), abs=1e-6)


@pytest.mark.parametrize("name", ["stair", "plum"])
def test_every_obstacle_can_stand_on_the_left_alone(name: str) -> None:
    profile = registry["terrain", name]().generate(np.random.default_rng(2))
    found = made(profile, one_sided=1.0)
    (x0, z0), (x1, z1) = profile.points[0], profile.points[-1]
    x = np.linspace(x0 - 0.5, max(x1, x0 + 1.0) + 0.5, 61) + 1e-3
    clear = [np.abs(profile.points[:, 0] - at).min() > 0.011 for at in x]  # as above
    left, right = (np.array([height_at(found, at, y) for at in x]) for y in (0.3, -0.3))
    assert left[clear] == pytest.approx([profile.height(at) for at in x[clear]], abs=1e-6)
    assert right == pytest.approx(np.interp(x, (x0, max(x1, x0 + 1.0)), (z0, z1)), abs=1e-6)
    assert np.abs(left - right).max() > 0.05


def test_a_stair_is_one_box_for_each_tread() -> None:
    stair = Profile([(0, 0), (0, 0.2), (0.3, 0.2), (0.3, 0.4), (0.6, 0.4), (0.6, 0.0)])
    assert len(made(stair)) == 4  # two treads, and the ground before and past them


def test_a_face_below_a_slope_is_a_board_of_its_own() -> None:
    # The tread behind the face is tilted, so that no column's side is the face.
    found = made(Profile([(0, 0), (0, 0.2), (0.5, 0.3), (0.5, 0.0)]))
    (face,) = (box for box in found if box.tilt == pytest.approx(math.pi / 2))
    (x, _, z), (length, width, thick), *_ = face
    assert (x - thick, z, length, width) == pytest.approx((0.0, 0.1, 0.1, 2.0))


def test_a_sharp_ridge_gets_the_thinnest_boards() -> None:
    found = made(Profile([(0, 0), (0.1, 0.3), (0.2, 0.0)]))
    assert [box.half[2] for box in found if box.tilt] == [0.005, 0.005]


@pytest.mark.parametrize("height", [0.2, -0.2])
def test_a_single_step_on_the_left_alone_is_an_incline_on_the_right(height: float) -> None:
    found = made(Profile([(0, 0), (0, height)]), one_sided=1.0)
    for x, left, right in ((-0.5, 0.0, 0.0), (0.5, 1.0, 0.5), (0.75, 1.0, 0.75), (1.5, 1.0, 1.0)):
        assert height_at(found, x, 0.3) == pytest.approx(left * height)
        assert height_at(found, x, -0.3) == pytest.approx(right * height)
    half = made(Profile([(0, 0), (0, height)]), one_sided=0.5)  # a step of half the height
    assert height_at(half, 0.001, -0.3) == pytest.approx(0.5 * height, abs=1e-3)
    assert height_at(half, 0.5, -0.3) == pytest.approx(0.75 * height)


SIDES = [
    {"oblique": 0.7},
    {"stagger": 0.3},
    {"oblique": -0.5, "one_sided": 1.0},
    {"oblique": 0.4, "stagger": 0.3, "one_sided": 0.5, "mirrored": True},
]


@pytest.mark.parametrize("sim", SIDES)
@pytest.mark.parametrize("name", ["pallet", "ramp"])
def test_sides_differ_as_the_settings_say(sim: dict[str, float], name: str) -> None:
    on = registry["terrain", name]().generate(np.random.default_rng(2))
    world, rng = place(on, **sim), np.random.default_rng(0)
    x, y = rng.uniform(-3.0, on.end + 3.0, 500), rng.uniform(-1.9, 1.9, 500)
    down = np.array([[0.0, 0.0, -1.0]])
    found = [
        3.0 - world.cast_rays(np.array([*at, 3.0]), down, 9.0)[0] for at in zip(x, y, strict=True)
    ]
    # The outline along the way is that of the profile; the rule is written for the left.
    across = -y if sim.get("mirrored") else y
    along = x - across * math.tan(sim.get("oblique", 0.0))
    right = np.where(across < 0, 1.0, 0.0)
    expected = np.array([on.height(at) for at in along - right * sim.get("stagger", 0.0)])
    expected *= 1 - right * sim.get("one_sided", 0.0)
    # The border in the middle is saw-toothed where edges lie obliquely, by half of 10 cm.
    clear = np.abs(y) > 0.05 * abs(math.tan(sim.get("oblique", 0.0)))
    assert np.array(found)[clear] == pytest.approx(expected[clear], abs=0.012)


def test_a_mirrored_ground_mirrors_the_motion() -> None:
    sim = {"one_sided": 1.0, "oblique": 0.3, "stagger": 0.1, "lateral_slope": 0.05}
    on = registry["terrain", "pallet"]().generate(np.random.default_rng(2))
    left, right = place(on, **sim), place(on, **sim, mirrored=True)
    for world in (left, right):
        world.command(0.5, 0.0)
        world.advance(500)
    assert abs(left.roll) > 0.02
    assert (right.roll, right.yaw) == pytest.approx((-left.roll, -left.yaw), abs=0.02)
    assert right.position == pytest.approx(left.position, abs=0.02)


def test_a_robot_starts_clear_of_edges_that_reach_back() -> None:
    world = place(Profile([(-0.2, 0), (-0.2, 0.2), (1, 0.2)]), oblique=0.7)
    assert world.penetration() <= OVERLAP


def test_roughness_shifts_patches_over_the_obstacle_alone() -> None:
    found = made(Profile([(0, 0), (2.0, 0)]), roughness=0.03)
    inside = [height_at(found, x, y) for x in (0.3, 1.0, 1.7) for y in (-0.5, 0.1, 0.5)]
    assert len(set(inside)) == 9
    assert max(map(abs, inside)) <= 0.03
    beside = [height_at(found, x, y) for x, y in ((-1.0, 0.1), (3.0, 0.1), (1.0, 1.5))]
    assert beside == pytest.approx([0.0, 0.0, 0.0])


# Recorded surfaces: strips along the line, which the robot feels as it feels a profile


class Grid(Surface):
    """A surface whose height is a function of x (X, 1) and y (Y,)."""

    def __init__(self, height: Height) -> None:
        self.height = height

    @property
    def x(self) -> np.ndarray:
        return X

    def heights(self, y: np.ndarray) -> np.ndarray:
        return self.height(X[:, None], y) + np.zeros((len(X), len(y)))


def profile(height: Height) -> Profile:
    surface = Grid(height)
    points = np.column_stack([X, surface.heights(np.zeros(1))[:, 0]])
    return Profile(points - (0.0, points[0, 1]), "grid", surface)


def block(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.where((x > 0.99) & (x < 2.01), 0.2, 0.0)


def place(on: Profile, **sim: Any) -> MujocoWorld:
    world = Mujoco(**sim).place(on, Robot(), Start(-1.0), np.random.default_rng(0))
    assert isinstance(world, MujocoWorld)
    return world


def test_the_boxes_follow_the_surface_at_the_middle_of_each_strip() -> None:
    recorded = profile(lambda x, y: 0.05 * np.sin(3 * x) + 0.1 * y)
    found = lay(recorded, Mujoco(), np.random.default_rng(0)).boxes
    for x in (0.313, 1.117, 2.451):
        for y, middle in ((0.03, 0.1), (-0.03, -0.1), (0.42, 0.5), (0.8, 0.85), (-1.5, -1.35)):
            expected = 0.05 * math.sin(3 * x) + 0.1 * middle
            assert height_at(found, x, y) == pytest.approx(expected, abs=1.1e-3)
    # The ground before and past the line is as level as the line.
    for x, z in ((-0.3, 0.0), (3.3, 0.05 * math.sin(9.0))):
        assert height_at(found, x, 0.42) == pytest.approx(z, abs=1e-6)
    # Beside the line it rises to the surface over 0.2 m.
    assert height_at(found, -0.1, 0.42) == pytest.approx(0.05 / 2, abs=1e-6)


def is_ground(found: list[Box], x: float, y: float, z: float) -> bool:
    """Return whether (x, y, z) lies in a box."""
    for (cx, cy, cz), (length, width, thick), tilt, _ in found:
        along = (x - cx) * math.cos(tilt) + (z - cz) * math.sin(tilt)
        across = (z - cz) * math.cos(tilt) - (x - cx) * math.sin(tilt)
        if abs(along) <= length and abs(across) <= thick and abs(y - cy) <= width:
            return True
    return False


def test_high_ground_beside_the_line_is_not_hollow() -> None:
    # A rough wall on the left, 0.9 m high, which begins at x = 1 m
    def wall(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (0.9 + 0.02 * np.sin(40 * x)) * ((x > 0.99) & (y > 0.2))

    found = lay(profile(wall), Mujoco(), np.random.default_rng(0)).boxes
    for x in np.arange(1.02, 2.98, 0.083):
        assert all(is_ground(found, x, 0.3, z) for z in np.arange(-0.25, 0.75, 0.1))
        assert not is_ground(found, x, 0.3, 0.93)
        assert not is_ground(found, x, 0.1, 0.01)


def test_a_surface_that_is_the_same_on_both_sides_is_the_extruded_profile() -> None:
    recorded = profile(block)
    made = lay(recorded, Mujoco(), np.random.default_rng(0)).boxes
    plain = lay(Profile(recorded.points), Mujoco(), np.random.default_rng(0)).boxes
    assert np.concatenate([[*b.centre, *b.half, b.tilt] for b in made]) == pytest.approx(
        np.concatenate([[*b.centre, *b.half, b.tilt] for b in plain])
    )


@pytest.mark.parametrize("setting", ["one_sided", "roughness"])
def test_ground_that_is_the_same_on_both_sides_is_changed_on_one(setting: str) -> None:
    # Equal strips are joined, though not where these settings make them different.
    found = lay(profile(block), Mujoco(**{setting: 0.1}), np.random.default_rng(0)).boxes
    left, right = (height_at(found, 1.51, y) for y in (0.13, -0.13))
    if setting == "one_sided":
        assert (left, right) == pytest.approx((0.2, 0.18))
    else:
        assert abs(left - right) > 1e-3
        assert (left, right) == pytest.approx((0.2, 0.2), abs=0.1)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_ground_that_is_higher_on_one_side_rolls_the_robot(side: float) -> None:
    world = place(profile(lambda x, y: 0.1 * (side * y > 0.0)), heading_gain=0.0)
    world.advance(1000)
    assert 0.6 < world.position[0] < 1.5
    # It lies on the edge in the middle and on its lower side's outer rim: atan(0.1 / 0.356)
    assert world.roll == pytest.approx(side * math.atan(0.1 / 0.356), abs=0.03)


def test_a_mirrored_surface_is_crossed_from_its_end() -> None:
    turned = MirroredSurface(Grid(lambda x, y: x + 10 * y), (3.0, 3.0))
    assert turned.x == pytest.approx(X)
    # What was at (3, 0) is at (0, 0); what was to the left is to the right.
    found = turned.heights(np.array([-0.1, 0.2]))
    assert found[0] == pytest.approx([1.0, -2.0])
    assert found[-1] == pytest.approx([1.0 - 3.0, -2.0 - 3.0])


def hole(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.where((x > 1.49) & (x < 1.61) & (y > 0.28) & (y < 0.9), np.nan, 0.1 * y)


def test_unknown_ground_is_an_error_where_the_robot_drives() -> None:
    expected = r"unknown 1\.50 m along the line and 0\.30 m to its left.* needs 0\.36 m to each"
    with pytest.raises(TerrainError, match=expected):
        place(profile(hole))
    # A robot of 0.17 m to each side passes it; the hole gets the height of the strip up to 0.2 m.
    narrow = Mujoco(flipper_offset=0.12, track_width=0.1)
    found = lay(profile(hole), narrow, np.random.default_rng(0)).boxes
    for x, y, z in ((1.55, 0.3, 0.01), (1.55, 0.5, 0.01), (1.3, 0.3, 0.03), (1.3, 0.5, 0.065)):
        assert height_at(found, x, y) == pytest.approx(z, abs=1e-6)
    with pytest.raises(TerrainError, match=r"0\.67 m to each side"):
        lay(profile(hole), narrow.model_copy(update={"offset": 0.5}), np.random.default_rng(0))


def test_ground_that_cannot_be_is_refused_with_whose_fault_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def gone(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        if len(y) > 1:
            raise ValueError("map.npy: there is no such file")
        return 0.0 * x

    with pytest.raises(TerrainError, match=r"sim=mujoco: map\.npy: there is no such file"):
        place(profile(gone))
    with monkeypatch.context() as patched:
        patched.setattr(ground, "MOST", 5)
        with pytest.raises(TerrainError, match="needs more than 5 boxes"):
            made(Profile([(0, 0), (2.0, 0)]), roughness=0.01)
        with pytest.raises(TerrainError, match=r"boxes; shorten the line, or raise sim\.str"):
            place(profile(lambda x, y: 0.1 * np.sin(x + y)))
    recorded = profile(block)
    monkeypatch.setattr(Grid, "heights", lambda self, y: np.zeros(3))
    text = r"Grid\.heights returned an array of the shape \(3,"
    with pytest.raises(PluginFailedError, match=text):
        place(recorded)


# Walls and posts beside the way: seen by rays, felt by nothing


STEP = Profile([(0.0, 0.0), (0.0, 0.1), (2.0, 0.1)])


def beside(**sim: object) -> MujocoWorld:
    engine = Mujoco(roughness=0.02, yaw=0.3, **sim)  # type: ignore[arg-type]
    return engine.place(STEP, Robot(), Start(-0.8), np.random.default_rng(4))


@pytest.mark.parametrize("scenery", ["walls", "posts"])
def test_the_motion_is_equal_bit_for_bit_without_the_scenery(scenery: str) -> None:
    # As near as possible: the robot, which is 0.36 m wide to each side, drives through its edge.
    worlds = [beside(), beside(scenery=scenery, scenery_distance=0.5)]
    for world in worlds:
        world.command(0.5, -0.3)
    assert np.array_equal(*(world.advance(400) for world in worlds))
    assert np.array_equal(*(world.data.qvel for world in worlds))


def test_rays_end_at_walls() -> None:
    origin = np.array([-1.0, 0.2, 0.5])
    sideways = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    found = beside(scenery="walls", scenery_distance=1.5).cast_rays(origin, sideways, 9.0)
    assert found == pytest.approx([1.3, 1.7, 0.5], abs=0.021)  # rough ground below


def test_posts_stand_at_irregular_places_on_both_sides() -> None:
    angles = np.radians(np.arange(0.0, 360.0, 0.5))
    around = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
    found = beside(scenery="posts").cast_rays(np.array([0.0, 0.0, 1.0]), around, 9.0)
    hit = np.isfinite(found)
    y = found[hit] * around[hit, 1]
    assert (np.abs(y) >= 1.5 - 1e-9).all()
    assert (y > 0).any()
    assert (y < 0).any()
    assert 0.05 < hit.mean() < 0.6
