"""Height maps in GeoTIFF files, which state their frame and often the unit of their heights.

Metres of ground per metre of a projection differ wherever it stretches the ground, as Mercator's.

In: a file. Out: a ``HeightMap`` in the file's own frame [m], with remarks on what it states.
"""

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.api import FloatArray

from .height_map import HeightMap, Part, cells_from_resolution
from .reading import known_heights

_UNSTATED = ("", "none", "unknown", "unnamed")
"""Names of units that programs write where they know none."""
SAME_LENGTH = 0.002
"""Deviation of a projection's scale from 1 that is ignored; UTM has up to 0.001 in its zone [-]."""
_STEP = 50.0
"""Distance over which the scale of a projection is measured [m of the projection]."""
_LENGTHS = {
    1000.0: "km kilometer kilometers kilometre kilometres",
    1.0: "m meter meters metre metres",
    0.1: "dm decimeter decimeters decimetre decimetres",
    0.01: "cm centimeter centimeters centimetre centimetres",
    0.001: "mm millimeter millimeters millimetre millimetres",
    0.0254: "in inch inches",
    0.3048: "ft foot feet ftus usft",
    0.9144: "yd yard yards",
}
"""Lengths [m] and their names in the units of bands; feet of all countries agree to 3 · 10⁻⁶."""
_KINDS_OF_FEET = ("us", "u", "s", "survey", "international", "intl", "statute")


def length_of(name: str) -> float | None:
    """Return the length [m] of a unit's name, such as "US survey foot" or "m (NAVD88)", or None."""
    words = [word for word in re.split(r"[\s()\[\],._-]+", name.lower()) if word]
    first = next((word for word in words if word not in _KINDS_OF_FEET), "")
    return next((metres for metres, names in _LENGTHS.items() if first in names.split()), None)


@dataclass(frozen=True)
class Coordinates:
    """The units of a coordinate reference system and its projection; by default metres."""

    plan: float = 1.0
    """Unit of x and y [m]; 0 if these are angles."""
    plan_name: str = "metre"
    """Name of that unit."""
    height: float | None = None
    """Unit of the heights [m]; None if the system has no heights."""
    height_name: str = ""
    """Name of that unit."""
    depths: bool = False
    """Whether the heights are depths, which grow downwards."""
    projected: Any = None
    """The projected system in the form of PROJJSON, if the system has one."""

    @classmethod
    def of(cls, crs: Any) -> "Coordinates":
        """Return what a CRS of rasterio states."""
        parts = list(_parts(crs.to_dict(projjson=True)))
        axes = [axis for part in parts for axis in part["coordinate_system"]["axis"]]
        upright = [axis for axis in axes if axis["direction"] in ("up", "down")]
        level = [axis for axis in axes if axis not in upright]
        plan, plan_name = _unit(level[0]) if level else (1.0, "metre")
        height, height_name = _unit(upright[0]) if upright else (None, "")
        depths = bool(upright) and upright[0]["direction"] == "down"
        projected = next((part for part in parts if "base_crs" in part), None)
        return cls(plan, plan_name, height, height_name, depths, projected)

    def stretch(self, place: FloatArray) -> FloatArray:
        """Return metres of ground per metre of the projection at (x, y) [m], (2, 2).

        The symmetric matrix turns a short step in (x, y) into one of the same length on the
        ellipsoid: half the unit matrix for Mercator's projection at 60°. It is the unit matrix
        where lengths agree within 0.2 %, and for systems without a projection.

        Raises:
            ValueError: the projection does not reach that place.
        """
        if self.projected is None:
            return np.eye(2)
        from rasterio.crs import CRS
        from rasterio.warp import transform

        # A short step each way, in the projection and in metres from the centre of the Earth
        base = self.projected["base_crs"]
        while "base_crs" in base:
            base = base["base_crs"]
        probes = place + _STEP * np.array([(-1, 0), (1, 0), (0, -1), (0, 1)])
        source, centred = (CRS.from_user_input(crs) for crs in (self.projected, _from_centre(base)))
        places = transform(source, centred, *(probes / self.plan).T, np.zeros(4))
        west, east, south, north = np.column_stack(places)
        steps = np.column_stack([east - west, north - south]) / (2 * _STEP)  # (3, 2)
        if not np.isfinite(steps).all():
            raise ValueError(f"its projection has no place at x = {place[0]:g}, y = {place[1]:g} m")

        # The symmetric part of the map between both, without its turn
        squares, axes = np.linalg.eigh(steps.T @ steps)
        scales = np.sqrt(squares)
        if np.abs(scales - 1).max() <= SAME_LENGTH:
            return np.eye(2)
        stretch: FloatArray = axes * scales @ axes.T
        return stretch


def _parts(crs: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the simple systems of which a system in PROJJSON is composed."""
    if "source_crs" in crs:
        yield from _parts(crs["source_crs"])
    elif "components" in crs:
        for part in crs["components"]:
            yield from _parts(part)
    else:
        yield crs


def _unit(axis: dict[str, Any]) -> tuple[float, str]:
    """Return the unit of an axis [m], 0 if it is an angle, and its name."""
    unit = axis.get("unit", "metre")
    if isinstance(unit, str):
        return float(unit == "metre"), unit
    factor, name = float(unit["conversion_factor"]), str(unit["name"])
    if unit["type"] == "AngularUnit" or np.isclose(factor, np.pi / 180, rtol=1e-6):
        return 0.0, name if unit["type"] == "AngularUnit" else "degree"
    return factor, name


def _from_centre(base: dict[str, Any]) -> dict[str, Any]:
    """Return the system of x, y and z from the centre of a geographic system's ellipsoid [m]."""
    axes = [
        {"name": axis, "abbreviation": axis, "direction": f"geocentric{axis}", "unit": "metre"}
        for axis in "XYZ"
    ]
    return base | {
        "type": "GeodeticCRS",
        "coordinate_system": {"subtype": "Cartesian", "axis": axes},
    }


def read_geotiff(
    path: Path, resolution: float | None, unit: float | None, rows: int, no_data: float | None
) -> HeightMap:
    """Return a map of the file's first band, in the file's own frame.

    A file without a frame needs a ``resolution`` [m], as an NPY file does. Heights are in ``unit``
    [m], or if that is None in the unit that the file states. Besides ``no_data``, the value that
    the file itself states and its mask mark unknown heights. The band's own scale and offset turn
    the stored numbers into heights; ``no_data`` is a stored number.

    Raises:
        ValueError: the band holds colours, the coordinates are degrees, the frame is stated twice
            or not at all, or the unit of the heights is unclear.
    """
    with _opened(path) as file:
        shape, transform, remarks = (file.height, file.width), file.transform, [*_bands(file)]
        crs = Coordinates.of(file.crs) if file.crs else Coordinates()
        metres = _height_unit(file.units[0] or "", crs) if unit is None else unit
    if unit is None and not file.units[0] and crs.plan != 1 and crs.height is None:
        remarks.append(
            f"it states a unit of x and y ({crs.plan_name}, {crs.plan:g} m) and none of the "
            "heights, which are taken for metres; terrain.unit states theirs"
        )

    # Depths are heights that grow downwards.
    if crs.depths:
        remarks.append("it states depths, which grow downwards; heights are their negatives")
        metres = -metres

    def heights(part: Part) -> tuple[FloatArray, str]:
        with _opened(path) as file:
            read = file.read(1, masked=True, window=part)
            scale, offset = file.scales[0], file.offsets[0]
        values = np.asarray(read.astype(np.float64).filled(np.nan))
        known, remark = known_heights(values, no_data, scale * metres)
        return (known * scale + offset) * metres, remark

    # Without a frame the resolution tells the cells; with one it must not.
    if transform.is_identity:
        to_cell = cells_from_resolution(resolution, rows)
        return HeightMap(shape, to_cell, heights, tuple(remarks))
    if resolution is not None:
        raise ValueError("the file states where its cells lie; a resolution must not be set too")
    if not crs.plan:
        raise ValueError(
            f"its coordinates are {crs.plan_name}s; project it to metres, as gdalwarp does"
        )

    # The frame's corner of a cell is half a cell from its centre.
    inverse = ~transform  # (x, y) → (column, row) of a cell's corner
    column = [inverse.a / crs.plan, inverse.b / crs.plan, inverse.c - 0.5]
    row = [inverse.d / crs.plan, inverse.e / crs.plan, inverse.f - 0.5]
    return HeightMap(shape, np.array([row, column]), heights, tuple(remarks), crs.stretch)


def _bands(file: Any) -> Iterator[str]:
    """Yield a remark if the first of several bands is taken.

    Raises:
        ValueError: the file states that its first band is a colour.
    """
    kinds = [kind.name for kind in file.colorinterp]
    if kinds[0] not in ("gray", "undefined"):
        raise ValueError(
            f"band 1 is stated to be {kinds[0]}, as in a picture; a map of heights is needed "
            "(gdal_edit.py -colorinterp_1 undefined corrects a wrong statement)"
        )
    if (count := len(kinds) - kinds.count("alpha")) > 1:
        name = f", {file.descriptions[0]!r}," if file.descriptions[0] else ""
        yield f"it has {count} bands; the first{name} is taken for the heights"


def _height_unit(band: str, crs: Coordinates) -> float:
    """Return the unit of the heights [m], from the band's unit and the file's coordinates."""
    if band.strip().lower() in _UNSTATED or band == crs.height_name:
        return crs.height or 1.0
    if (metres := length_of(band)) is None:
        raise ValueError(
            f"the unit of its heights is stated to be {band[:40]!r}, which is no known length; "
            "terrain.unit states it"
        )
    if crs.height is not None and not np.isclose(metres, crs.height, rtol=1e-4):
        raise ValueError(
            f"its band states the unit {band[:40]!r}, its vertical coordinates state "
            f"{crs.height_name!r}; terrain.unit states which is right"
        )
    return metres


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, driver="GTiff") as file:
            yield file
