"""Recorded ground: a profile, a height map, a mesh or a point cloud from a file."""

import logging
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property, partial
from pathlib import Path
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import FloatArray, Profile, Terrain, terrain

from ..recordings import cloud, height_map, polyline
from ..recordings.height_map import HeightMap
from ..recordings.line import Line
from ..recordings.mesh import Mesh, read_mesh
from ..recordings.surface import RecordedSurface

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048}
MAPS = {".npy": height_map.read_npy, **dict.fromkeys((".tif", ".tiff"), height_map.read_geotiff)}
CLOUDS = {".pcd": cloud.read_pcd, ".ply": cloud.read_ply, ".xyz": cloud.read_xyz}
MESHES = (".stl", ".obj", ".dae")
SUFFIXES = (".csv", *MAPS, *MESHES, *CLOUDS)
EXAMPLE = Path(polyline.__file__).with_name("example.csv")
MIN_POINTS = 10
"""Smallest number of points in a slice through a cloud [-]."""
MAX_LENGTH = 10_000.0
"""Largest extent of a profile [m]; a larger one suggests a wrong unit."""


@terrain("profile_file")
class ProfileFile(Terrain):
    """The same recorded ground each episode; the file's suffix determines its format.

    ``.csv``: columns x (forward) and z (up), x never decreasing.
    ``.npy``, ``.tif``: a height map; the profile is taken along the line from ``start`` to ``end``.
    ``.stl``, ``.obj``, ``.dae``: a mesh seen from above, along that line.
    ``.pcd``, ``.ply``, ``.xyz``: a point cloud; the profile is a slice along that line.
    GeoTIFF, meshes, PCD and PLY need the extra ``profiles``.
    """

    path: str | None = Field(
        None, description="file to read; null is a small example that is included [-]"
    )
    unit: Literal["m", "cm", "mm", "ft"] = Field(
        "m",
        description="unit of the file's coordinates; for a map, of its heights only; a .dae "
        "states its unit and the axis that points up [-]",
    )
    start: tuple[float, float] | None = Field(
        None, description="x and y at which the line over the ground begins [m]"
    )
    end: tuple[float, float] | None = Field(
        None, description="x and y at which that line ends; the robot drives towards it [m]"
    )
    spacing: float = Field(
        0.02, ge=0.005, le=0.5, description="distance between two heights on the line [m]"
    )
    largest_gap: float = Field(
        0.2, ge=0, le=5, description="longest distance without a height that is interpolated [m]"
    )
    resolution: float | None = Field(
        None, gt=0, le=10, description="size of a map's cells, if the file does not contain it [m]"
    )
    rows: Literal["+y", "-y"] = Field(
        "+y",
        description="direction of the rows of such a map; its first cell lies at (0, 0) and its "
        "columns run along x [-]",
    )
    up: Literal["x", "y", "z", "-x", "-y", "-z"] = Field(
        "z",
        description="axis of a cloud's or mesh's frame that points up; start and end are given in "
        "the other two axes, as x and y of a right-handed frame [-]",
    )
    thickness: float = Field(
        0.1, gt=0, le=2, description="thickness of the vertical slice through a cloud [m]"
    )
    quantile: float = Field(
        0.9, ge=0, le=1, description="quantile of the cloud's heights at a place to take [-]"
    )
    largest_mesh: int = Field(
        2_000_000, ge=1, le=100_000_000, description="largest number of faces of a mesh [-]"
    )

    @model_validator(mode="after")
    def _stated(self) -> Self:
        suffix = self._file.suffix.lower()
        if suffix not in SUFFIXES:
            raise ValueError(f"path {self.path}: one of {', '.join(SUFFIXES)} is allowed")
        stated = [self.start is not None, self.end is not None]
        if suffix == ".csv" and any(stated):
            raise ValueError(
                "start and end belong to maps, meshes and clouds; a .csv is the line itself"
            )
        if suffix != ".csv" and not all(stated):
            raise ValueError(
                f"a {suffix} file needs start and end, the line over the ground in metres: "
                "'terrain.start=[x,y]' 'terrain.end=[x,y]'"
            )
        if suffix == ".dae" and (self.unit, self.up) != ("m", "z"):
            raise ValueError("a .dae states its unit and axes; unit and up must not be stated too")
        if self.start is not None and self.end is not None:
            length = math.dist(self.start, self.end)
            if not 0 < length <= MAX_LENGTH:
                raise ValueError(
                    f"the line from start {self.start} to end {self.end} is {length:g} m long; "
                    f"above 0 and up to {MAX_LENGTH:g} m is allowed"
                )
        return self

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the recorded profile, beginning at (0, 0); ``rng`` is not used."""
        return self._profile

    def files_read(self) -> tuple[Path, ...]:
        """Return the recorded file."""
        return (self._file,)

    @property
    def _file(self) -> Path:
        try:
            return EXAMPLE if self.path is None else Path(self.path).expanduser()
        except RuntimeError as error:  # there is no such user
            raise ValueError(f"path {self.path}: {error}") from error

    @cached_property
    def _profile(self) -> Profile:
        points = self._points()
        surface = None
        if self._file.suffix.lower() in (*MAPS, *MESHES):
            height = float(points[0, 1])
            surface = RecordedSurface(points[:, 0], partial(self._beside, height))
        return Profile(points - points[0], self._file.stem, surface)

    def _points(self) -> FloatArray:
        """Read the points, (V, 2) of x and z [m].

        Raises:
            ValueError: the file is missing, unreadable or does not fit the settings.
        """
        with self._naming_file() as file:
            points = self._read(file, file.suffix.lower())
        extent = np.ptp(points, axis=0)
        if not (np.isfinite(points).all() and extent.max() <= MAX_LENGTH):
            raise ValueError(
                f"{file}: it covers {extent[0]:g} m in x and {extent[1]:g} m in z; up to "
                f"{MAX_LENGTH:g} m is allowed: is its unit {self.unit!r}? terrain.unit states it"
            )
        return points

    def _read(self, file: Path, suffix: str) -> FloatArray:
        if self.start is None or self.end is None:
            return polyline.read_csv(file) * UNITS[self.unit]
        line = Line(self.start, self.end, self.spacing)
        if suffix in CLOUDS:
            points = cloud.upright(CLOUDS[suffix](file) * UNITS[self.unit], self.up)
            found = cloud.slice_along(points, line, self.thickness, self.quantile, MIN_POINTS)
            return line.profile(found, self.largest_gap)
        unknown = "the mesh is not closed" if suffix in MESHES else "no height is known"
        return line.profile(self._ground(file).along(line), self.largest_gap, unknown)

    def _ground(self, file: Path) -> HeightMap | Mesh:
        """Return the map or the mesh, which may be read anywhere."""
        suffix, unit = file.suffix.lower(), UNITS[self.unit]
        if suffix in MESHES:
            return read_mesh(file, unit, self.up, self.largest_mesh)
        return MAPS[suffix](file, self.resolution, unit, 1 if self.rows == "+y" else -1)

    def _beside(self, height: float, y: FloatArray) -> FloatArray:
        """Return the heights above ``height`` at all points of the line and at ``y``, (D, Y) [m].

        Raises:
            ValueError: the file cannot be read.
        """
        assert self.start is not None
        assert self.end is not None
        line = Line(self.start, self.end, self.spacing)
        with self._naming_file() as file:
            found = self._ground(file).beside(line, line.distances, y)
        columns = [line.bridged(column, self.largest_gap) for column in found.T]
        return np.column_stack(columns) - height

    @contextmanager
    def _naming_file(self) -> Iterator[Path]:
        """Name the file in whatever its reader raises, as a ValueError."""
        file = self._file
        try:
            with file.open("rb"):  # raises the system's own message if the file cannot be read
                pass
            with _quiet():
                yield file
        except ImportError as error:
            raise ValueError(
                f"{file}: {file.suffix} files need the package {error.name}; "
                "install flipperctl[profiles]"
            ) from error
        except FileNotFoundError as error:
            raise ValueError(f"{file}: there is no such file") from error
        except Exception as error:  # on a damaged file, a reader may raise any exception
            reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
            raise ValueError(f"{file}: {' '.join(str(reason).split())[:300]}") from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Make readers report faults as errors: raise their warnings and silence their logs.

    A logger with a handler of its own does not write to stderr.
    """
    for name in ("rasterio", "trimesh"):
        logger = logging.getLogger(name)
        if not logger.handlers:
            logger.addHandler(logging.NullHandler())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", PendingDeprecationWarning)  # addressed to libraries
        yield
