"""Clouds as drivers, scanners and other programs write them, and what is said about them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pypcd4.pypcd4 import PointCloud
from trimesh.util import concatenate

from tests.plugins.test_layers import terrain_of
from tests.plugins.test_mesh import solid
from tests.plugins.test_profile_file import write_cloud

LINE = {"start": (0.0, 0.0), "end": (2.9, 0.0)}


def strip(begin: float, end: float, z: float, dx: float = 0.02) -> np.ndarray:
    """Return points of a level strip of ±0.05 m beside the x axis, (P, 3) [m]."""
    x, y = np.meshgrid(np.arange(begin, end, dx), np.linspace(-0.05, 0.05, 5))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, z)])


def at(points: np.ndarray, x: float, y: float, z: float) -> np.ndarray:
    """Return the points moved by x, y and z [m]."""
    return points + np.array([x, y, z])


def heights(path: Path, **fields: Any) -> tuple[tuple[float, float], str]:
    """Return the lowest and the highest point of a file's profile [m], and all remarks on it."""
    terrain = terrain_of(path, **{**LINE, **fields})
    z = terrain.generate(np.random.default_rng(0)).points[:, 1]
    return (round(float(z.min()), 3), round(float(z.max()), 3)), "\n".join(terrain.notices())


def save(path: Path, points: np.ndarray) -> Path:
    """Write a cloud; a .csv has a header."""
    if path.suffix == ".csv":
        np.savetxt(path, points, delimiter=",", header="x,y,z", comments="", fmt="%.4f")
    else:
        write_cloud(path, points)
    return path


NONE = np.vstack([np.zeros((300, 3)), np.full((50, 3), np.nan), np.full((50, 3), np.inf)])
FLOOR = strip(-1.5, 1.5, -0.5)
AROUND = {"start": (-1.4, 0.0), "end": (1.4, 0.0), "largest_gap": 0.7}


@pytest.mark.parametrize("suffix", ["csv", "pcd"])
def test_rays_without_return_are_left_out(suffix: str, tmp_path: Path) -> None:
    floor = FLOOR[np.abs(FLOOR[:, 0]) > 0.3]
    file = save(tmp_path / f"scan.{suffix}", np.vstack([NONE, floor]))
    assert heights(file, **AROUND) == (
        (0.0, 0.0),
        f"{file}: 300 points lie exactly at 0 0 0, as rays without return are stored; they are "
        "left out",
    )
    moved = {**AROUND, "start": (-0.4, 0.0), "end": (2.4, 0.0)}  # after a registration
    save(file, at(np.vstack([NONE, floor]), 1.0, 0.0, 0.75))
    found, remarks = heights(file, **moved)
    assert found == (0.0, 0.0)
    assert "300 points lie exactly at 1 0 0.75, as rays" in remarks


RANDOM = np.random.default_rng(0).uniform((-1.5, -0.05, 0), (1.5, 0.05, 0.004), (2000, 3))


@pytest.mark.parametrize(
    "points",
    [
        strip(-1.5, 1.5, 0.0),  # one of them at the origin
        np.repeat(np.append(RANDOM * (1, 1, 0), np.zeros((1, 3)), axis=0), 5, axis=0),  # five scans
        RANDOM.round(2),
    ],
)
def test_measured_points_at_the_origin_are_kept(points: np.ndarray, tmp_path: Path) -> None:
    found, remarks = heights(save(tmp_path / "floor.xyz", points), **AROUND)
    assert found == (0.0, 0.0)
    assert remarks == ""


GRID = np.vstack([strip(0, 1.5, 0.0), strip(1.5, 3.0, 0.15)])
GRID = np.vstack([at(GRID, 0, 0.1 * i, 0.03 * i) for i in (-3, -2, -1, 0, 1, 2, 3)])


@pytest.mark.parametrize(
    ("header", "order", "sign", "comma"),
    [("x,y,z", "xyz", ",", "."), ("Z;Y;X", "zyx", ";", ","), (None, "xyz", ",", ".")],
)
def test_a_cloud_in_a_csv_is_no_profile(
    header: str | None, order: str, sign: str, comma: str, tmp_path: Path
) -> None:
    points = GRID if header else GRID[np.argsort(GRID[:, 0], kind="stable")]
    rows = points[:, ["xyz".index(axis) for axis in order]]
    lines = [sign.join(f"{value:.3f}" for value in row).replace(".", comma) for row in rows]
    file = tmp_path / "grid.csv"
    file.write_text("\n".join([*([header] if header else []), *lines]))
    with pytest.raises(ValueError, match=r"terrain\.start and terrain\.end"):
        heights(file, start=None, end=None)
    assert heights(file) == ((0.0, 0.15), "")


def test_few_digits_are_said_and_a_grid_is_not(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform((0, -0.3, 0), (3, 0.3, 0.01), (4000, 3))
    file = tmp_path / "few.xyz"
    np.savetxt(file, points, fmt="%.1f")
    assert "rounded (x to 0.1 m and y to 0.1 m)" in heights(file)[1]
    np.savetxt(file, at(strip(0, 3, 0.0, dx=0.1), 551_152, 5.4e6, 300), fmt="%.3f")
    assert heights(file, start=(551_152, 5.4e6), end=(551_154.9, 5.4e6)) == ((0.0, 0.0), "")


@pytest.mark.parametrize(
    ("pose", "viewpoint", "found", "text"),
    [
        # The floor has a step of 0.2 m; the scanner leans by 90°: its z runs along x.
        ("0 0 1 2 0 2 0", True, (0.0, 0.2), ""),
        ("0 0 1 2 0 2 0", None, None, "states a pose at 0 0 1, turned by 90°, by which its points"),
        ("0 0 1 2 0 2 0", False, None, ""),
        ("0 0 0 -1 0 0 0", None, None, ""),
    ],
)
def test_the_pose_of_a_pcd_is_said_or_applied(
    pose: str, viewpoint: bool | None, found: tuple[float, float] | None, text: str, tmp_path: Path
) -> None:
    floor = np.vstack([strip(0, 1, 0.0), strip(1, 3, 0.2)]) - (0, 0, 1)
    file = tmp_path / "pose.pcd"
    PointCloud.from_xyz_points(floor @ np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])).save(file)
    file.write_bytes(file.read_bytes().replace(b"0.0 0.0 0.0 1.0 0.0 0.0 0.0", pose.encode()))
    line = {} if found else {"start": (0.8, -0.05), "end": (0.8, 0.05)}  # across the scanner's x
    low_and_high, remarks = heights(file, viewpoint=viewpoint, thickness=2.0, **line)
    assert found in (None, low_and_high)
    assert remarks.count("VIEWPOINT") == bool(text)
    assert text in remarks


@pytest.mark.parametrize(
    ("header", "row", "text"),
    [
        ("x y z i", "{0} {1} {2} 7", None),
        ("I,X,Y,Z", "7,{0},{1},{2}", None),
        ("", "{0};;{2}", "found: 0"),
        ("x y z", "{0} {1} up", "line 2: x, y and z must .* '-0\\.350', 'up'\\)"),
    ],
)
def test_columns_of_a_text_file_are_named_or_the_first(
    header: str, row: str, text: str | None, tmp_path: Path
) -> None:
    file = tmp_path / "scan.xyz"
    rows = (row.format(*(f"{value:.3f}" for value in point)) for point in GRID)
    file.write_text("\n".join([header, *rows]))
    if text is None:
        assert heights(file) == ((0.0, 0.15), "")
        return
    with pytest.raises(ValueError, match=text):
        heights(file)


def between(begin: float, end: float, floor: np.ndarray) -> np.ndarray:
    return floor[(floor[:, 0] < begin) | (floor[:, 0] > end)]


FLAT = strip(0, 3, 0.0)
HOLE = between(1.001, 1.119, FLAT)
STRIPES = strip(0.06, 3, 2.5, dx=0.5)
FACE = np.vstack([strip(1.5, 1.51, z) for z in np.arange(0.0, 2.0, 0.1)])


@pytest.mark.parametrize(
    ("parts", "lowest", "highest"),
    [
        # What hangs over a small hole in the floor is not ground:
        ((HOLE, STRIPES), 0, 0),
        ((HOLE, strip(0.6, 1.12, 2.5)), 0, 0),  # up to the hole
        ((FLAT[FLAT[:, 0] > 0.1], strip(0, 3, 2.5)), 0, 0),  # at the start
        ((FLAT[FLAT[:, 0] < 2.75], strip(2.5, 3, 2.5)), 0, 0),  # at the end
        ((strip(0, 1, 0), strip(1.12, 3, 0.2), STRIPES), 0, 0.2),  # a step at the hole
        # A wall, a ledge and a ridge are, and a ceiling over a longer hole, as documented:
        ((between(1.5, 1.6, FLAT), strip(1.5, 1.6, 2.0)), 0, 2.0),  # a wall seen from above
        ((between(1.5, 1.6, FLAT), FACE, strip(0, 3, 3.5)), 0, 1.71),  # one seen from its front
        ((FLAT[FLAT[:, 0] > 1], strip(0, 1, 1.2)), -1.2, 0),
        ((FLAT[FLAT[:, 0] > 0.3], strip(0, 3, 2.5)), -2.5, 0),
    ],
)
def test_what_hangs_over_a_hole_in_a_cloud_is_told_from_walls(
    parts: tuple[np.ndarray, ...], lowest: float, highest: float, tmp_path: Path
) -> None:
    file = save(tmp_path / "scan.xyz", np.vstack(parts))
    found, remarks = heights(file)
    assert found == (lowest, highest)
    assert ("a face at x = " in remarks) == (highest - lowest > 1)
    if highest - lowest < 1:
        assert "only something 1 m or more above the ground beside it was measured at " in remarks
    else:
        assert "another unit may be right, or no ground was found there below something" in remarks


def test_few_points_of_the_floor_below_a_dense_ceiling_are_ground(tmp_path: Path) -> None:
    ceiling = np.random.default_rng(0).uniform((1, -0.05, 2.4), (1.1, 0.05, 2.5), (1000, 3))
    assert heights(save(tmp_path / "scan.xyz", np.vstack([FLAT, ceiling])))[0] == (0, 0)
    ghosts = strip(0, 3, -3.0, dx=0.5)[::5]  # of reflections, which nothing continues
    scan = np.vstack([np.repeat(FLAT, 4, axis=0), ghosts])
    assert heights(save(tmp_path / "scan.xyz", scan)) == ((0, 0), "")


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
@pytest.mark.parametrize("coloured", [False, True])
def test_a_ply_with_faces_is_a_mesh(encoding: str, coloured: bool, tmp_path: Path) -> None:
    steps = concatenate([solid(((0, -1, -1), (3, 1, 0))), solid(((1, -1, 0), (3, 1, 0.15)))])
    if coloured:
        steps.visual.vertex_colors = np.full((len(steps.vertices), 4), 200, np.uint8)
    file = tmp_path / "steps.ply"
    file.write_bytes(steps.export(file_type="ply", encoding=encoding))
    assert heights(file) == ((0.0, 0.15), "")
    terrain = terrain_of(file, **LINE)
    beside = terrain.generate(np.random.default_rng(0)).surface.heights(np.array([0.3]))
    assert beside.max() == pytest.approx(0.15)
