"""Ground below ceilings and bridges, bodies in meshes, and what a recording's user is told."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flipperctl_plugins.recorded_ground.layers import (
    Choice,
    Crossings,
    ground_of_faces,
    layer_of_points,
)
from trimesh import Trimesh
from trimesh.util import concatenate

from flipperctl.config import resolver
from flipperctl.errors import TerrainError
from tests.plugins.test_mesh import solid, without, write
from tests.plugins.test_profile_file import LINE, assert_block, profile, scanned, write_cloud

BLOCK = [((0, 0, 6), (4, 3, 7)), ((1.5, 0, 6.9), (2.5, 3, 7.3))]
CEILING = ((0, 0, 9.5), (4, 3, 9.6))


@pytest.mark.parametrize(
    ("faces", "lowest", "highest"),
    [
        # (height, 1 looks up and -1 looks down), below each other; a headroom of 1 m
        ([(0, 1)], 0, 0),
        ([(-1, -1), (0, 1)], 0, 0),
        ([(-1, -1), (0, 1), (3, -1), (3.1, 1)], 0, 3.1),  # a ceiling
        ([(0, 1), (3, 1)], 0, 3),  # two sheets
        ([(0, 1), (3, -1)], 0, None),  # a floor and a ceiling that looks down
        ([(-1, -1), (-0.1, -1), (0, 1), (2, 1)], 2, 2),  # a wall that stands in the ground
        ([(-0.1, -1), (0, 1), (2, 1)], 2, 2),  # a wall on a sheet: doubtful, thus the wall's top
        ([(-1, -1)], None, None),  # a bottom through a hole
        ([(0, 1), (0, 1), (3, -1), (3, 1)], 0, 3),  # an edge of two faces, a sheet of two sides
        ([], None, None),
    ],
)
def test_the_ground_is_a_layer_with_room_above_it(
    faces: list[tuple[float, int]], lowest: float | None, highest: float | None
) -> None:
    rng = np.random.default_rng(0)
    for expected, choice in ((lowest, Choice(1.0, False)), (highest, Choice(1.0, True))):
        # The same faces above the first and the last of three places, in any order.
        place = np.repeat([0, 2], len(faces)).astype(np.int64)
        height = np.array([z for z, _ in faces] * 2, dtype=float)
        front = np.array([sign > 0 for _, sign in faces] * 2, dtype=bool)
        order = rng.permutation(len(place))
        crossings = Crossings(place[order], height[order], front[order])
        found = ground_of_faces(crossings, 3, choice).height
        wanted = np.nan if expected is None else expected
        assert found == pytest.approx(np.array([wanted, np.nan, wanted]), nan_ok=True)


def test_stray_points_are_no_layer() -> None:
    floor = np.linspace(0.0, 0.02, 30)
    heights = np.concatenate([floor, [-5.0], 2.5 + floor])
    found, above = layer_of_points(heights, Choice(1.0, False))
    assert above == 2.5
    assert found == pytest.approx(floor)
    assert layer_of_points(heights, Choice(1.0, True))[0] == pytest.approx(2.5 + floor)
    assert layer_of_points(np.append(floor, 2.5), Choice(1.0, False))[1] == np.inf


def test_the_robot_drives_below_a_ceiling_in_the_plane_and_in_3d(tmp_path: Path) -> None:
    write(tmp_path / "room.obj", solid(*BLOCK, CEILING))
    assert_block(profile(tmp_path / "room.obj", **LINE), 0.02)
    above = profile(tmp_path / "room.obj", highest=True, **LINE)
    assert np.ptp(above.points[:, 1]) < 1e-6
    settings = {"name": "profile_file", "path": str(tmp_path / "room.obj"), **LINE}
    terrain = resolver.create("terrain", settings, "terrain")
    surface = terrain.generate(np.random.default_rng(0)).surface
    beside = surface.heights(np.array([-0.3, 0.0, 0.3]))
    assert beside[[0, 50, 100]] == pytest.approx(np.array([[0.0], [0.3], [0.0]]) * np.ones(3))


def test_a_cloud_of_a_room_is_its_floor(tmp_path: Path) -> None:
    floor = scanned()
    ceiling = floor[:-2] * (1, 1, 0) + (0, 0, 9.5)
    write_cloud(tmp_path / "room.xyz", np.vstack([floor, ceiling]))
    assert_block(profile(tmp_path / "room.xyz", **LINE), 0.02)
    above = profile(tmp_path / "room.xyz", highest=True, **LINE)
    assert np.ptp(above.points[:, 1]) < 1e-6


def test_a_room_that_is_closed_and_seen_from_inside_is_refused(tmp_path: Path) -> None:
    room = solid(((0, 0, 0), (4, 3, 2.5)))
    room.faces = room.faces[:, ::-1]
    write(tmp_path / "room.stl", room)
    with pytest.raises(TerrainError, match="inside out: it is closed and its faces look inward"):
        profile(tmp_path / "room.stl", **LINE)


def sheet(low: float, high: float, z: float) -> Trimesh:
    corners = [(low, 0, z), (high, 0, z), (high, 3, z), (low, 3, z)]
    return Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)


def terrain_of(path: Path, **fields: Any) -> Any:
    settings = {"name": "profile_file", "path": str(path), **fields}
    return resolver.create("terrain", settings, "terrain")


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ("0,0\n1,0\n1,1.4\n1.5,1.4\n1.5,0\n", "a face at x = 1.00 m is 1.4 m high, more than 1 m"),
        ("10.00000,100\n10.00001,100.02\n", "the line is 1e-05 m long; terrain.unit=m is set, "),
        ("0,0\n0.5,0\n0.6,-9999\n0.65,0\n1,0\n", "1 values such as -9999 are treated as unknown"),
    ],
)
def test_a_wrong_unit_and_missing_values_of_a_csv_are_said(
    rows: str, text: str, tmp_path: Path
) -> None:
    (tmp_path / "ground.csv").write_text(f"x,z\n{rows}")
    (found,) = terrain_of(tmp_path / "ground.csv").notices()
    assert text in found


SLAB = [((0, 0, -1), (3, 3, 0)), ((3, 0, -1), (8, 3, 0.2)), ((0, 0, 0.7), (8, 3, 0.8))]
LONG = {"start": (0.5, 1.5), "end": (7.5, 1.5)}


def test_a_slab_that_is_too_low_to_drive_below_is_said(tmp_path: Path) -> None:
    write(tmp_path / "slab.obj", solid(*SLAB))
    found = terrain_of(tmp_path / "slab.obj", **LONG)
    assert np.ptp(found.generate(np.random.default_rng(0)).points[:, 1]) < 1e-6
    (notice,) = found.notices()
    assert "less than 1 m above a lower surface at 351 of 351 places along the line" in notice
    assert "the robot drives on the upper one there (terrain.headroom=1 is set" in notice
    (notice, below) = terrain_of(tmp_path / "slab.obj", headroom=0.6, **LONG).notices()[:2]
    assert "lies 0.6 m or more above the ground" in notice
    assert "less than 0.6 m above a lower surface" in below
    assert terrain_of(tmp_path / "slab.obj", highest=True, **LONG).notices()[1:] == ()


@pytest.mark.parametrize("ceiling", [sheet(0, 8, 2.5), solid(((0, 0, 2.5), (8, 3, 2.6)))])
def test_a_small_hole_in_the_floor_below_a_ceiling_is_bridged(
    ceiling: Trimesh, tmp_path: Path
) -> None:
    file = tmp_path / "room.obj"
    floor = [sheet(0, 3, 0), sheet(3, 5, 0.2), sheet(5.12, 8, 0.2)]
    write(file, concatenate([*floor, ceiling]))
    found = terrain_of(file, **LONG).generate(np.random.default_rng(0))
    assert found.points[:, 1].max() == pytest.approx(0.2)
    assert found.surface.heights(np.array([-0.3, 0.0])).max() == pytest.approx(0.2)
    (notice,) = terrain_of(file, **LONG).notices()  # the sheets that meet at 3 m are a step
    assert "lies 1 m or more above the ground" in notice
    wide = terrain_of(file, largest_gap=0.1, **LONG).generate(np.random.default_rng(0))
    assert wide.points[:, 1].max() >= 2.5


@pytest.mark.parametrize(
    ("value", "fields"), [(-9999, {}), (-32768, {}), (3.4028235e38, {}), (77.0, {"no_data": 77.0})]
)
def test_missing_values_of_a_map_are_unknown_ground(
    value: float, fields: dict[str, Any], tmp_path: Path
) -> None:
    heights = np.zeros((61, 81), np.float32)  # 3 m × 4 m in cells of 5 cm
    heights[44:47, 38:42] = value  # from 0.2 to 0.3 m left of the line, for 0.15 m
    np.save(tmp_path / "map.npy", heights)
    settings = {"name": "profile_file", "path": str(tmp_path / "map.npy"), "resolution": 0.05}
    terrain = resolver.create("terrain", {**settings, **LINE, **fields, "largest_gap": 0.0}, "")
    surface = terrain.generate(np.random.default_rng(0)).surface
    assert np.isnan(surface.heights(np.array([0.25]))).any()
    (notice,) = terrain.notices()
    assert "within 0.4 m of the line heights are unknown at" in notice
    heights[38:42, 38:42] = value  # on the line
    np.save(tmp_path / "map.npy", heights)
    with pytest.raises(TerrainError, match="no height is known from 0"):
        profile(tmp_path / "map.npy", resolution=0.05, **LINE, **fields)
    wide = profile(tmp_path / "map.npy", resolution=0.05, largest_gap=0.4, **LINE, **fields)
    assert np.ptp(wide.points[:, 1]) == 0


ALONG = {"start": (0.1, 0.0), "end": (3.9, 0.0)}


def tiled(z: float, tiles: int = 1, *, down: bool = False) -> Trimesh:
    """Return a level sheet, 4 m × 2 m, of tiles that share their corners' places."""
    x, y = np.linspace(0, 4, tiles + 1), np.linspace(-1, 1, tiles + 1)
    parts = [
        Trimesh([(a, c, z), (b, c, z), (b, d, z), (a, d, z)], [(0, 1, 2), (0, 2, 3)], process=False)
        for a, b in pairwise(x)
        for c, d in pairwise(y)
    ]
    found = concatenate(parts)
    if down:
        found.faces = found.faces[:, ::-1]
    return found


def body(low: float, high: float, x: tuple[float, float] = (1.5, 2.5), y: float = 0.5) -> Trimesh:
    return solid(((x[0], -y, low), (x[1], y, high)))


OPEN = Trimesh(body(0, 0.4).vertices, body(0, 0.4).faces[2:], process=False)  # half a side misses


@pytest.mark.parametrize(
    ("parts", "highest"),
    [
        ([tiled(0), body(0, 0.4), tiled(3)], 0.4),
        ([tiled(0), body(-0.05, 0.4), tiled(3)], 0.4),  # sunk into the floor
        ([tiled(0, 8), body(0, 0.4), tiled(3)], 0.4),  # its edges are edges of tiles, too
        ([tiled(0), OPEN, tiled(3)], 0.4),
        ([tiled(0), without(body(0, 0.4), 0), tiled(3)], 0.4),  # without a bottom
        ([tiled(0), tiled(0, down=True), tiled(3)], 0.0),  # a floor of two sides
        ([tiled(0), body(1.5, 1.6), tiled(3)], 0.0),  # a bridge
        ([tiled(0), body(0.7, 0.75), tiled(3)], 0.75),  # a table
        ([tiled(0), body(0, 3), tiled(3)], 3.0),  # a pillar
        ([tiled(0), body(-0.1, 2)], 2.0),  # walls that stand in sheets
    ],
)
def test_a_body_between_sheets_is_ground(
    parts: Sequence[Trimesh], highest: float, tmp_path: Path
) -> None:
    file = tmp_path / "ground.obj"
    write(file, concatenate(list(parts)))
    terrain = terrain_of(file, **ALONG)
    profile = terrain.generate(np.random.default_rng(0))
    assert profile.points[:, 1].max() == pytest.approx(highest, abs=1e-3)
    assert profile.points[:, 1].min() == pytest.approx(0, abs=1e-6)
    assert not any("not closed" in remark for remark in terrain.notices())
    beside = profile.surface.heights(np.array([-0.3, 0.2]))
    assert np.nanmax(beside) <= highest + 1e-6
