"""What a GeoTIFF states counts: units of heights, local coordinates, its projection, colours."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from flipperctl_plugins.recorded_ground.geotiff import length_of
from rasterio.transform import Affine, from_origin

from tests.plugins.test_layers import terrain_of

KERB = np.where(np.arange(100) < 50, 0.0, 0.5)[None].repeat(30, 0)  # half a unit high
FOOT = 0.3048
LATER = {"units", "scales", "offsets", "colorinterp"}
"""What is set after the bands are written."""


def write(
    file: Path, bands: np.ndarray, crs: str | None, corner: tuple[float, float], **more: Any
) -> None:
    """Write bands of cells of 0.1; ``corner`` is the upper left one [the file's unit]."""
    later = {key: more.pop(key) for key in LATER & more.keys()}
    bands = np.atleast_3d(bands.T).T  # one band or several
    how: dict[str, Any] = {"transform": from_origin(*corner, 0.1, 0.1), **more}
    with rasterio.open(
        file, "w", driver="GTiff", height=bands.shape[1], width=bands.shape[2], count=len(bands),
        dtype=bands.dtype.name, crs=crs, **how,
    ) as out:  # fmt: skip
        out.write(bands)
    with rasterio.open(file, "r+") as out:
        for key, value in later.items():
            setattr(out, key, (value,) * len(bands) if key != "colorinterp" else value)


def rise(
    file: Path, plan: float = 1.0, x: float = 0.0, **fields: Any
) -> tuple[float, tuple[str, ...]]:
    """Return the height of the kerb [m] along the middle of a map at (x, 3), and remarks.

    ``plan`` is the unit of its x and y [m].
    """
    line = {"start": (x + 0.5 * plan, 1.5 * plan), "end": (x + 9 * plan, 1.5 * plan)}
    terrain = terrain_of(file, **line, **fields)
    points = terrain.generate(np.random.default_rng(0)).points
    assert points[-1, 0] == pytest.approx(8.5 * plan)
    return float(points[-1, 1]), terrain.notices()


@pytest.mark.parametrize(
    ("crs", "units", "fields", "metres"),
    [
        ("EPSG:26913+6360", None, {}, FOOT),
        ("EPSG:26913+6360", "ft", {}, FOOT),
        ("EPSG:26913", "US survey foot", {}, FOOT),
        (None, "feet", {}, FOOT),
        ("EPSG:26913", None, {}, 1.0),
        ("EPSG:26913+6360", None, {"unit": "m"}, 1.0),  # what the user states prevails
        ("EPSG:26913+6360", "m", {"unit": "ft"}, FOOT),
        ("EPSG:26913", "degC", {"unit": "dm"}, 0.1),
    ],
)
def test_heights_are_in_the_unit_that_the_file_states(
    crs: str | None, units: str | None, fields: dict[str, Any], metres: float, tmp_path: Path
) -> None:
    corner = (400_000 if crs else 0, 3)
    write(tmp_path / "kerb.tif", KERB, crs, corner, **({"units": units} if units else {}))
    found, notices = rise(tmp_path / "kerb.tif", x=corner[0], **fields)
    assert found == pytest.approx(0.5 * metres, rel=1e-5)
    assert notices == ()


def test_the_band_s_scale_and_offset_come_before_its_unit(tmp_path: Path) -> None:
    write(tmp_path / "a.tif", KERB, None, (0, 3), units="ft", scales=0.1, offsets=700.0)
    assert rise(tmp_path / "a.tif")[0] == pytest.approx(0.05 * FOOT)


def test_units_that_are_unclear_are_refused_and_depths_are_said(tmp_path: Path) -> None:
    write(tmp_path / "a.tif", KERB, None, (0, 3), units="degC")
    with pytest.raises(ValueError, match=r"stated to be 'degC', which is no known length; terrain"):
        rise(tmp_path / "a.tif")
    write(tmp_path / "a.tif", KERB, "EPSG:26913+6360", (0, 3), units="m")
    with pytest.raises(
        ValueError, match=r"states the unit 'm', its vertical coordinates state 'US"
    ):
        rise(tmp_path / "a.tif")
    write(tmp_path / "a.tif", KERB, "EPSG:26913+5715", (400_000, 3))
    found, (notice,) = rise(tmp_path / "a.tif", x=400_000)
    assert found == pytest.approx(-0.5)
    assert "it states depths" in notice


def test_names_of_lengths() -> None:
    names = {"u.s. survey feet": FOOT, "m (NAVD88)": 1.0, "Inches": 0.0254, "m/s": None, "m2": None}
    assert {name: length_of(name) for name in names} == names


@pytest.mark.parametrize(
    ("crs", "plan"),
    [
        ('LOCAL_CS["site grid",LOCAL_DATUM["site",0],UNIT["metre",1]]', 1.0),
        ('LOCAL_CS["site grid",UNIT["foot",0.3048]]', FOOT),
        (
            'ENGCRS["site",EDATUM["x"],CS[Cartesian,2],AXIS["x",east],AXIS["y",north],'
            'LENGTHUNIT["metre",1]]',
            1.0,
        ),
    ],
)
def test_a_map_of_a_site_in_local_coordinates_is_read(
    crs: str, plan: float, tmp_path: Path
) -> None:
    write(tmp_path / "site.tif", KERB, crs, (0, 3))
    found, notices = rise(tmp_path / "site.tif", plan)
    assert found == 0.5
    assert any("states a unit of x and y (foot, 0.3048 m)" in text for text in notices) == (
        plan != 1
    )
    assert rise(tmp_path / "site.tif", plan, unit="ft")[0] == pytest.approx(0.5 * FOOT)
    degrees = 'LOCAL_CS["site",UNIT["degree",0.0174532925199433]]'
    write(tmp_path / "site.tif", KERB, degrees, (0, 3))
    with pytest.raises(ValueError, match="its coordinates are degrees; project it to metres"):
        rise(tmp_path / "site.tif")


# On a sphere, Mercator's projection stretches by 1 / cos φ. On the ellipsoid of WGS 84, a degree of
# longitude at 60° is 0.50126 of one on the equator, and the radius along the meridian there is
# 6394.2 km, of the sphere of Web Mercator 1.00253 times its 6378.137 km: also 0.50126 northwards.
@pytest.mark.parametrize(
    ("crs", "place", "direction", "scale"),
    [
        ("EPSG:3857", (1.11e6, 8399737.89), 0, 0.50126),
        ("EPSG:3857", (1.11e6, -8399737.89), 0, 0.50126),
        ("EPSG:3857", (20037508.0, 8399737.89), 0, 0.50126),  # at the 180th meridian
        ("EPSG:3395", (1.11e6, 8362698.55), 30, 0.50126),
        ("EPSG:4087", (1.11e6, 6679169.45), 0, 0.50126),  # equidistant: only along parallels
        ("EPSG:3413", (0.0, -541966.7), 45, 1.0291),
        ("+proj=eqc +R=3396190", (0.0, np.radians(60) * 3396190), 0, 0.5),  # on Mars
        ("EPSG:32632", (500_000.0, 5_500_000.0), 0, 1.0),  # 0.9996 is within the tolerance
        ("EPSG:2154", (700_000.0, 6_600_000.0), 0, 1.0),
    ],
)
def test_lengths_are_those_of_the_ground(
    crs: str, place: tuple[float, float], direction: float, scale: float, tmp_path: Path
) -> None:
    # A ramp of 30° and 2 m on the ground, in a raster turned by the direction of the line.
    along = (np.arange(200) - 99.5) * 0.05 * scale
    ramp = np.tan(np.pi / 6) * np.clip(along + 1, 0, 2)[None].repeat(60, 0)
    turned = Affine.translation(*place) * Affine.rotation(direction) * Affine.scale(0.05, -0.05)
    write(tmp_path / "a.tif", ramp, crs, (0, 0), transform=turned * Affine.translation(-100, -30))
    step = 4.5 * np.array([np.cos(np.radians(direction)), np.sin(np.radians(direction))])
    terrain = terrain_of(
        tmp_path / "a.tif", start=tuple(place - step), end=tuple(place + step), spacing=0.01
    )
    profile = terrain.generate(np.random.default_rng(0))
    length, height = profile.points[-1]
    assert length == pytest.approx(9 * scale, rel=1e-4)
    assert height == pytest.approx(2 * np.tan(np.pi / 6))
    middle = np.interp(length / 2 + np.array([-0.4, 0.4]), *profile.points.T)
    assert np.diff(middle)[0] / 0.8 == pytest.approx(np.tan(np.pi / 6), rel=1e-3)
    assert any("of its projection is" in text for text in terrain.notices()) == (scale != 1)
    # 1.2 m to the side it is still known; the raster reaches 1.5 m of the projection.
    beside = profile.surface.heights(np.array([-1.2 * min(scale, 1), 0.0]))
    assert beside[:, 0] == pytest.approx(beside[:, 1], abs=1e-6)


PICTURE = np.random.default_rng(0).integers(90, 160, (4, 30, 100)).astype(np.uint8)


@pytest.mark.parametrize(
    ("bands", "more", "colour"),
    [
        (PICTURE[:3], {"photometric": "RGB"}, "red"),
        (PICTURE[0], {"photometric": "PALETTE"}, "palette"),
    ],
)
def test_colours_are_no_heights(
    bands: np.ndarray, more: dict[str, Any], colour: str, tmp_path: Path
) -> None:
    write(tmp_path / "photo.tif", bands, "EPSG:25832", (0, 3), **more)
    with pytest.raises(ValueError, match=f"band 1 is stated to be {colour}, as in a picture"):
        rise(tmp_path / "photo.tif", unit="mm")
