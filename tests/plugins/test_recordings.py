"""Recorded ground of any origin: spreadsheets' dialects are read, false headers are refused."""

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from flipperctl.errors import TerrainError
from tests.plugins.test_profile_file import LINE, assert_block, profile, scanned, write_cloud

CURB = np.array([(0.0, 0.0), (0.0, 0.2), (0.8, 0.2)])


@pytest.mark.parametrize(
    "data",
    [
        b"\xef\xbb\xbfx,z\r\n1,0.5\r\n1,0.7\r\n1.8,0.7\r\n",
        b"X ; Z\r\n1;0,5\r\n1;0,7\r\n1,8;0,7\r\n;\r\n",
        "sep=;\r\nx;z\r\n1;0.5\r\n1;0.7\r\n1.8;0.7\r\n".encode("utf-16"),
        "Höhe\tx\tz\n9\t1\t0,5\n9\t1\t0,7\n9\t1,8\t0,7\n".encode("cp1252"),
        b'\n"x","z"\n"1","0.5"\n\n 1, 0.7\n1.8,0.7',
        b"x,z,\r1,0.5,\r1,0.7,\r1.8,0.7,",
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


@pytest.mark.parametrize("points", [2**60, 2**34, -1, "many"])
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


def test_a_point_of_too_many_numbers_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "scan.pcd"
    file.write_text(_PCD.format(points=0, data="ascii", count="1 1 1099511627776"))
    with pytest.raises(TerrainError, match="1000 are allowed"):
        profile(file, **LINE)


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


def test_a_folder_and_too_long_a_name_are_refused(tmp_path: Path) -> None:
    folder = tmp_path / "ground.csv"
    folder.mkdir()
    with pytest.raises(TerrainError, match=r"ground\.csv: Is a directory"):
        profile(folder)
    with pytest.raises(TerrainError, match="File name too long"):
        profile(Path("x" * 300 + ".csv"))
