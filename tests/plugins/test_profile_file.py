"""Recorded ground: a file of any format gives the outline written to it; false ones are refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from pypcd4.pypcd4 import PointCloud
from rasterio.transform import Affine, from_origin
from trimesh import PointCloud as PlyCloud

from flipperctl.api import Profile
from flipperctl.config import resolver
from flipperctl.config.identity import read_files
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError, TerrainError

LINE = {"start": (1.0, 2.0), "end": (3.0, 2.0)}
"""A line along x over a map or through a cloud."""


def profile(path: Path | None = None, **fields: Any) -> Profile:
    settings = {"name": "profile_file", "path": path and str(path), **fields}
    found = resolver.create("terrain", settings, "terrain")
    env = FlipperEnv(found)  # raises the errors that a user sees
    env.reset(seed=0)
    return env.profile


def block(x: np.ndarray) -> np.ndarray:
    """Return the heights of a block 0.3 m high from x = 1.5 to 2.5 m, on ground at 7 m."""
    return np.where((x > 1.495) & (x < 2.505), 7.3, 7.0)


def assert_block(found: Profile, step: float) -> None:
    """Check for the block from x = 1 m on, with points at most ``step`` [m] apart in x."""
    assert found.end == pytest.approx(2.0)
    for x, z in ((0.0, 0.0), (0.4, 0.0), (0.6, 0.3), (1.4, 0.3), (1.6, 0.0), (2.0, 0.0)):
        assert found.height(x) == pytest.approx(z, abs=1e-6)
    assert np.diff(found.points[:, 0]).max() <= step + 1e-9


def test_a_csv_is_a_profile_in_its_unit(tmp_path: Path) -> None:
    file = tmp_path / "curb.csv"
    file.write_text("time, X, Z\n0, 100, 5\n1, 100, 25\n2, 180, 25\n")
    found = profile(file, unit="cm")
    assert found.points == pytest.approx(np.array([(0, 0), (0, 0.2), (0.8, 0.2)]))
    assert found.label == "curb.csv"


def test_a_file_must_be_named() -> None:
    terrain = resolver.create("terrain", {"name": "profile_file"}, "terrain")
    with pytest.raises(ConfigError, match=r"terrain\.path=ground\.csv"):
        read_files(terrain)
    with pytest.raises(TerrainError, match=r"terrain\.path=ground\.csv"):
        profile()


def test_a_large_csv_is_read_equally_and_its_fault_is_named(tmp_path: Path) -> None:
    file = tmp_path / "large.csv"
    lines = [f"{i}, {0.001 * i:.4f}, {0.0001 * (i % 7):.5f}\n" for i in range(60_000)]
    file.write_text("line, x, z\n" + "".join(lines))
    assert file.stat().st_size > 1 << 20
    found = profile(file)
    assert found.end == pytest.approx(59.999)
    assert len(found.points) < 15_000
    file.write_text(file.read_text() + "60000, 60.0, up\n")
    with pytest.raises(TerrainError, match="line 60002: x and z must be numbers"):
        profile(file)
    file.write_text("line, x, z\n" + "".join(lines) + "60000, 3.0, 0.0\n")
    with pytest.raises(TerrainError, match=r"line 60002: x goes back from 59\.999 to 3"):
        profile(file)


@pytest.mark.parametrize("rows", ["+y", "-y"])
def test_a_height_map_is_sampled_along_a_line(rows: str, tmp_path: Path) -> None:
    file = tmp_path / "map.npy"
    heights = np.tile(block(np.arange(81) * 0.05), (61, 1))  # 4 m × 3 m, one column every 5 cm
    np.save(file, heights * 1000)
    y = 2.0 if rows == "+y" else -2.0
    line = {"start": (1.0, y), "end": (3.0, y)}
    assert_block(profile(file, resolution=0.05, unit="mm", rows=rows, **line), 0.02)
    other = {"start": (1.0, -y), "end": (3.0, -y)}
    with pytest.raises(TerrainError, match=r"\(1\.0, .*\) lies outside the map.* to 4\.00 m"):
        profile(file, resolution=0.05, rows=rows, **other)


def test_heights_between_cells_are_bilinear(tmp_path: Path) -> None:
    file = tmp_path / "plane.npy"
    y, x = np.mgrid[0:4, 0:5] * 0.5
    np.save(file, 0.1 * x + 0.2 * y)
    found = profile(file, resolution=0.5, start=(0.0, 0.0), end=(1.5, 1.5), spacing=0.1)
    # Along the diagonal the plane rises by 0.3 m on √2 m.
    assert found.points[:, 1] == pytest.approx(0.3 / np.sqrt(2) * found.points[:, 0])


def write_tiff(file: Path, heights: np.ndarray, **how: Any) -> None:
    with rasterio.open(
        file, "w", driver="GTiff", height=heights.shape[0], width=heights.shape[1], count=1,
        dtype="float32", compress="lzw", **how,
    ) as out:  # fmt: skip
        out.write(heights.astype("float32"), 1)


def test_a_geotiff_contains_its_frame(tmp_path: Path) -> None:
    heights = np.tile(block(np.arange(80) * 0.05 + 0.025), (60, 1))  # 4 m × 3 m
    heights[:3] = -9999.0
    file = tmp_path / "map.tif"
    # Its upper left corner lies at (500 km, 4000 km): rows run against y.
    write_tiff(file, heights, nodata=-9999.0, crs="EPSG:32633",
               transform=from_origin(500_000.0, 4_000_000.0, 0.05, 0.05))  # fmt: skip
    line = {"start": (500_001.0, 3_999_998.0), "end": (500_003.0, 3_999_998.0)}
    assert_block(profile(file, **line), 0.02)
    unknown = {"start": (500_001.0, 3_999_999.95), "end": (500_003.0, 3_999_999.95)}
    with pytest.raises(TerrainError, match="no height is known along the line"):
        profile(file, **unknown)
    with pytest.raises(TerrainError, match="a resolution must not be set"):
        profile(file, resolution=0.05, **line)


def test_degrees_and_an_unknown_frame_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "degrees.tif"
    write_tiff(file, np.zeros((5, 5)), crs="EPSG:4326", transform=from_origin(10, 50, 0.1, 0.1))
    with pytest.raises(TerrainError, match="degrees; project it to metres"):
        profile(file, **LINE)
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        write_tiff(tmp_path / "bare.tif", np.zeros((50, 50)), transform=Affine.identity())
    with pytest.raises(TerrainError, match=r"set terrain\.resolution"):
        profile(tmp_path / "bare.tif", **LINE)
    assert profile(tmp_path / "bare.tif", resolution=0.1, **LINE).end == pytest.approx(2.0)


def scanned() -> np.ndarray:
    """Return a cloud of the block, 4 m × 3 m, with a high point beside the line and a NaN."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform((0, 0), (4, 3), (40_000, 2)).T
    ground = np.column_stack([x, y, block(x)])
    return np.vstack([ground, [(2.0, 2.2, 12.0)], [(1.7, 2.0, np.nan)]])


def write_cloud(file: Path, points: np.ndarray) -> None:
    if file.suffix == ".pcd":
        PointCloud.from_xyz_points(points).save(file)
    elif file.suffix == ".ply":
        file.write_bytes(PlyCloud(points).export(file_type="ply"))
    else:
        np.savetxt(file, points, delimiter=", ", header="x y z")


@pytest.mark.parametrize("suffix", ["pcd", "ply", "xyz"])
def test_a_point_cloud_is_sliced_along_the_line(suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"scan.{suffix}"
    write_cloud(file, scanned())
    assert_block(profile(file, **LINE), 0.02)
    with pytest.raises(
        TerrainError,
        match=r"points are needed within .* found: 0; the cloud covers x from 0\.00 to 4",
    ):
        profile(file, start=(8.0, 2.0), end=(9.0, 2.0))
    with pytest.raises(TerrainError, match=r"no height is known from 3\.\d+ to 5\.00 m"):
        profile(file, start=(1.0, 2.0), end=(6.0, 2.0))


def test_a_camera_s_frame_is_turned_upright(tmp_path: Path) -> None:
    file = tmp_path / "camera.xyz"
    x, y, z = scanned()[:-1].T
    write_cloud(file, np.column_stack([x, -z, y]))  # axes: right, down, ahead
    assert_block(profile(file, up="-y", **LINE), 0.02)


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("none.csv", None, "there is no such file"),
        ("bad.csv", "a,b\n1,2\n", "columns x and z is needed; it has ['a', 'b']"),
        ("bad.csv", "x,z\n0,0\n1,up\n", "line 3: x and z must be numbers; they are ('1', 'up')"),
        ("bad.csv", "x,z\n0,0\n1,0\n0.5,0\n", "line 4: x goes back from 1 to 0.5"),
        ("bad.csv", "x,z\n0,0\n0,5,0,1\n", "line 3: it has 4 values for 2 columns; where the dec"),
        ("bad.csv", "x,z\n0,0\n1e300,0\n", "it covers 1e+300 m in x"),
        ("bad.csv", "x,z\n0\0,0\n", "it is not a text file"),
        ("bad.npy", "no array", "bad.npy: "),
        ("bad.tif", "no picture", "bad.tif: "),
        ("bad.pcd", "no cloud", "bad.pcd: "),
        ("bad.xyz", "no cloud", "bad.xyz: "),
    ],
)
def test_a_bad_file_is_named_in_one_line(
    name: str, content: str | None, text: str, tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(TerrainError) as caught:
        profile(tmp_path / name, **({} if name.endswith("csv") else LINE))
    assert text in str(caught.value)
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"path": "scan.ply"}, "needs start and end"),
        ({"path": "scan.csv", "end": (3, 2)}, "a .csv file needs start and end"),
        ({"path": "scan.ply", "start": (1, 1), "end": (1, 1)}, "is 0 m long; above 0"),
        ({"path": "a.ply", "start": (0, 0), "end": (1e15, 0)}, r"is 1e\+15 m long; above 0"),
    ],
)
def test_settings_must_fit_the_file(fields: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        resolver.create("terrain", {"name": "profile_file", **fields}, "terrain")


CURB = np.array([(0.0, 0.0), (0.0, 0.2), (0.8, 0.2)])


@pytest.mark.parametrize(
    "data",
    [
        b"\xef\xbb\xbfx,z\r\n1,0.5\r\n1,0.7\r\n1.8,0.7\r\n",
        b"X ; Z\r\n1;0,5\r\n1;0,7\r\n1,8;0,7\r\n;\r\n",
        "sep=;\r\nx;z\r\n1;0.5\r\n1;0.7\r\n1.8;0.7\r\n".encode("utf-16"),
        "Höhe\tx\tz\n9\t1\t0,5\n9\t1\t0,7\n9\t1,8\t0,7\n".encode("cp1252"),
    ],
)
def test_a_csv_of_any_spreadsheet_is_read(data: bytes, tmp_path: Path) -> None:
    file = tmp_path / "curb.csv"
    file.write_bytes(data)
    assert profile(file).points == pytest.approx(CURB)


@pytest.mark.parametrize("row", ["{:.4f} {:.4f} {:.4f}", "{:.4f};{:.4f};{:.4f}"])
def test_an_xyz_with_decimal_commas_is_read(row: str, tmp_path: Path) -> None:
    file = tmp_path / "scan.xyz"
    lines = (row.format(*point).replace(".", ",") for point in scanned()[:-1])
    file.write_text("\n".join(lines))
    assert_block(profile(file, **LINE), 0.02)


_PCD = (
    "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT {count}\nWIDTH {points}\nHEIGHT 1\n"
    "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA {data}\n"
)
_PLY = "ply\nformat {data} 1.0\nelement vertex {points}\nproperty float x\nproperty float y\n"
_PLY += "property float z\nend_header\n"


@pytest.mark.parametrize("points", [2**60, "many"])
@pytest.mark.parametrize(
    ("name", "header", "data"),
    [
        ("scan.pcd", _PCD, "ascii"),
        ("scan.pcd", _PCD, "binary"),
        ("scan.pcd", _PCD, "binary_compressed"),
        ("scan.ply", _PLY, "ascii"),
        ("scan.ply", _PLY, "binary_little_endian"),
    ],
)
def test_a_header_that_claims_too_much_is_refused_before_memory_is_taken(
    name: str, header: str, data: str, points: object, tmp_path: Path
) -> None:
    file = tmp_path / name
    text = header.format(points=points, data=data, count="1 1 1")
    file.write_bytes(text.encode() + b"\x10\0\0\0\xff\xff\xff\xff" * 2)
    with pytest.raises(TerrainError, match=r"a file of \d+ bytes can hold|whole number") as caught:
        profile(file, **LINE)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize("suffix", ["pcd", "ply"])
def test_a_cloud_with_fewer_points_than_its_header_claims_is_refused(
    suffix: str, tmp_path: Path
) -> None:
    file = tmp_path / f"scan.{suffix}"
    write_cloud(file, scanned())
    file.write_bytes(file.read_bytes()[:-12])  # a point of three float32
    with pytest.raises(TerrainError, match=str(file)):
        profile(file, **LINE)


@pytest.mark.parametrize("shape", [(2**40, 2**20), (-4, 5), (10**9, 10)])
def test_a_map_that_claims_too_much_is_refused(shape: tuple[int, int], tmp_path: Path) -> None:
    file = tmp_path / "map.npy"
    with file.open("wb") as out:
        header = {"descr": "<f8", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(out, header)
        out.write(bytes(800))
    with pytest.raises(TerrainError, match=r"map\.npy: "):
        profile(file, resolution=0.1, **LINE)


def test_of_a_large_map_only_the_cells_around_the_line_are_read(tmp_path: Path) -> None:
    file = tmp_path / "large.tif"
    with rasterio.open(
        file, "w", driver="GTiff", height=200_000, width=200_000, count=1, dtype="float32",
        sparse_ok=True, tiled=True, transform=from_origin(0, 20_000, 0.1, 0.1), bigtiff="yes",
    ):  # fmt: skip
        pass
    assert profile(file, start=(5.0, 5.0), end=(9.0, 5.0)).end == pytest.approx(4.0)
    with pytest.raises(TerrainError, match="cells lie around the line"):
        profile(file, start=(5.0, 5.0), end=(5000.0, 5000.0), spacing=0.5)


ALONG = np.round(np.arange(0, 3, 0.05), 3)


@pytest.mark.parametrize(
    "points",
    [
        [(0, 0), (0, 0.2), (0.3, 0.2), (0.3, 0.4), (0.6, 0.4), (0.6, 0)],
        [(x, z) for x in (0, 0.3, 0.6, 0.9) for z in (0, 0.1)],  # saw teeth
        [
            (0, 0),
            *((0.5, z / 100) for z in range(21)),
            *((0.7, z / 100) for z in range(20, -1, -1)),
        ],
        [(0, 0), (0.5, 0), (0.5, 0.001), (0.5, 0), (0.6, 0), (0.6, 0.001), (0.6, 0), (1, 0)],
        [(0, 0), (0.5, 0), (0.5, 0.3), (0.5, 0), (1, 0)],
    ],
)
def test_vertical_faces_are_a_profile(points: list[tuple[float, float]], tmp_path: Path) -> None:
    lines = "".join(f"{x},{z}\n" for x, z in points)
    (tmp_path / "faces.csv").write_text("x,z\n" + lines)
    assert profile(tmp_path / "faces.csv").points == pytest.approx(np.array(points))
