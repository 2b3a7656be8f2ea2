"""Height maps in GeoTIFF files, which state their frame and often the unit of their heights.

In: a file. Out: a ``HeightMap`` in the file's own frame [m], with remarks on what it states.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.api import FloatArray

from .coordinates import Coordinates, length_of
from .height_map import HeightMap, Part, cells_from_resolution
from .reading import without_missing

_UNSTATED = ("", "none", "unknown", "unnamed")
"""Names of units that programs write where they know none."""


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
    if crs.depths:
        remarks.append("it states depths, which grow downwards; heights are their negatives")
        metres = -metres

    def heights(part: Part) -> tuple[FloatArray, str]:
        with _opened(path) as file:
            read = file.read(1, masked=True, window=part)
            scale, offset = file.scales[0], file.offsets[0]
        values = np.asarray(read.astype(np.float64).filled(np.nan))
        found, remark = without_missing(values, no_data)
        return (found * scale + offset) * metres, remark

    if transform.is_identity:
        to_cell = cells_from_resolution(resolution, rows)
        return HeightMap(shape, to_cell, heights, tuple(remarks))
    if resolution is not None:
        raise ValueError("the file states where its cells lie; a resolution must not be set too")
    if not crs.plan:
        raise ValueError(
            f"its coordinates are {crs.plan_name}s; project it to metres, as gdalwarp does"
        )
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
