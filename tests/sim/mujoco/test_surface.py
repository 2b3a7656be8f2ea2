"""Recorded surfaces: strips along the line, which the robot feels as it feels a profile."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from flipperctl.api import MirroredSurface, Profile, Robot, Start, Surface
from flipperctl.errors import PluginFailedError, TerrainError
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.mujoco import ground as ground_boxes
from flipperctl.sim.mujoco.ground import Box, boxes
from flipperctl.sim.mujoco.world import MujocoWorld
from tests.sim.mujoco.test_ground import surface as height_at

X = np.arange(0.0, 3.001, 0.02)


class Grid(Surface):
    """A surface whose height is a function of x (X, 1) and y (Y,)."""

    def __init__(self, height: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
        self.height = height

    @property
    def x(self) -> np.ndarray:
        return X

    def heights(self, y: np.ndarray) -> np.ndarray:
        return self.height(X[:, None], y) + np.zeros((len(X), len(y)))


def profile(height: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Profile:
    surface = Grid(height)
    points = np.column_stack([X, surface.heights(np.zeros(1))[:, 0]])
    return Profile(points - (0.0, points[0, 1]), "grid", surface)


def block(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.where((x > 0.99) & (x < 2.01), 0.2, 0.0)


def place(ground: Profile, **sim: float) -> MujocoWorld:
    world = Mujoco(**sim).place(ground, Robot(), Start(-1.0), np.random.default_rng(0))
    assert isinstance(world, MujocoWorld)
    return world


def test_the_boxes_follow_the_surface_at_the_middle_of_each_strip() -> None:
    ground = profile(lambda x, y: 0.05 * np.sin(3 * x) + 0.1 * y)
    found = boxes(ground, Mujoco(), np.random.default_rng(0))
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
    for (cx, cy, cz), (length, width, thick), tilt in found:
        along = (x - cx) * math.cos(tilt) + (z - cz) * math.sin(tilt)
        across = (z - cz) * math.cos(tilt) - (x - cx) * math.sin(tilt)
        if abs(along) <= length and abs(across) <= thick and abs(y - cy) <= width:
            return True
    return False


def test_high_ground_beside_the_line_is_not_hollow() -> None:
    # A rough wall on the left, 0.9 m high, which begins at x = 1 m
    def wall(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (0.9 + 0.02 * np.sin(40 * x)) * ((x > 0.99) & (y > 0.2))

    found = boxes(profile(wall), Mujoco(), np.random.default_rng(0))
    for x in np.arange(1.02, 2.98, 0.083):
        assert all(is_ground(found, x, 0.3, z) for z in np.arange(-0.25, 0.75, 0.1))
        assert not is_ground(found, x, 0.3, 0.93)
        assert not is_ground(found, x, 0.1, 0.01)


def test_a_surface_that_is_the_same_on_both_sides_is_the_extruded_profile() -> None:
    ground = profile(block)
    made = boxes(ground, Mujoco(), np.random.default_rng(0))
    plain = boxes(Profile(ground.points), Mujoco(), np.random.default_rng(0))
    assert np.concatenate([[*b.centre, *b.half, b.tilt] for b in made]) == pytest.approx(
        np.concatenate([[*b.centre, *b.half, b.tilt] for b in plain])
    )


@pytest.mark.parametrize("setting", ["one_sided", "roughness"])
def test_ground_that_is_the_same_on_both_sides_is_changed_on_one(setting: str) -> None:
    # Equal strips are joined, though not where these settings make them different.
    found = boxes(profile(block), Mujoco(**{setting: 0.1}), np.random.default_rng(0))
    left, right = (height_at(found, 1.51, y) for y in (0.13, -0.13))
    if setting == "one_sided":
        assert (left, right) == pytest.approx((0.2, 0.18))
    else:
        assert abs(left - right) > 1e-3
        assert (left, right) == pytest.approx((0.2, 0.2), abs=0.1)


def test_the_robot_drives_over_strips_as_over_the_extruded_profile() -> None:
    # Strips whose heights differ by less than 1 µm are not joined.
    strips = profile(lambda x, y: block(x, y) + 1e-6 * y * (x > 0.5))
    worlds = place(strips), place(Profile(strips.points))
    assert worlds[0].model.ngeom > worlds[1].model.ngeom + 20
    poses = []
    for world in worlds:
        world.command(0.6, 0.3)
        poses.append([world.advance(700)])
        world.command(0.0, 0.0)
        poses[-1].append(world.advance(1300))
    first, second = (np.concatenate(pose) for pose in poses)
    assert second[:, 1].max() > 0.29  # both climbed
    arrivals = [int(np.argmax(pose[:, 0] > 2.6)) for pose in (first, second)]
    assert arrivals[0] == pytest.approx(arrivals[1], rel=0.01)
    assert np.sqrt(np.mean((first - second)[:, 2] ** 2)) < 0.01
    assert abs(worlds[0].state().side) < 0.02


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
    found = boxes(profile(hole), narrow, np.random.default_rng(0))
    for x, y, z in ((1.55, 0.3, 0.01), (1.55, 0.5, 0.01), (1.3, 0.3, 0.03), (1.3, 0.5, 0.065)):
        assert height_at(found, x, y) == pytest.approx(z, abs=1e-6)
    with pytest.raises(TerrainError, match=r"0\.67 m to each side"):
        boxes(profile(hole), narrow.model_copy(update={"offset": 0.5}), np.random.default_rng(0))


def test_too_many_boxes_of_a_surface_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ground_boxes, "MOST", 20)
    with pytest.raises(
        TerrainError, match=r"more than 20 boxes; shorten the line, or raise sim\.str"
    ):
        place(profile(lambda x, y: 0.1 * np.sin(x + y)))


def test_a_surface_that_cannot_be_read_is_the_request_s_fault() -> None:
    def gone(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        if len(y) > 1:
            raise ValueError("map.npy: there is no such file")
        return 0.0 * x

    with pytest.raises(TerrainError, match=r"sim=mujoco: map\.npy: there is no such file"):
        place(profile(gone))


def test_heights_of_a_wrong_shape_are_the_surface_s_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    ground = profile(block)
    monkeypatch.setattr(Grid, "heights", lambda self, y: np.zeros(3))
    with pytest.raises(
        PluginFailedError, match=r"Grid\.heights returned an array of the shape \(3,"
    ):
        place(ground)
