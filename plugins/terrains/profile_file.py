"""Ground that was recorded: a profile, a height map or a point cloud from a file."""

from functools import cached_property
from pathlib import Path
from typing import Literal, Self

import numpy as np
from flipperctl_plugins.recordings import cloud, height_map, polyline
from flipperctl_plugins.recordings.line import Line
from pydantic import Field, model_validator

from flipperctl.api import FloatArray, Profile, Terrain, terrain

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048}
MAPS = {".npy": height_map.read_npy, **dict.fromkeys((".tif", ".tiff"), height_map.read_geotiff)}
CLOUDS = {".pcd": cloud.read_pcd, ".ply": cloud.read_ply, ".xyz": cloud.read_xyz}
SUFFIXES = (".csv", *MAPS, *CLOUDS)
EXAMPLE = Path(polyline.__file__).with_name("example.csv")
FEWEST = 10  # points of a slice

_UNREADABLE = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    IndexError,
    TypeError,
    AttributeError,
    RuntimeError,
)


@terrain("profile_file")
class ProfileFile(Terrain):
    """The same recorded ground each episode; the file's suffix says what it is.

    ``.csv``: columns x (forward) and z (up), x never decreasing.
    ``.npy``, ``.tif``: a height map; the profile is taken along the line from ``start`` to ``end``.
    ``.pcd``, ``.ply``, ``.xyz``: a point cloud; the profile is a slice along that line.
    GeoTIFF, PCD and PLY need the extra ``profiles``.
    """

    path: str | None = Field(
        None, description="the file; null is a small example that comes along [-]"
    )
    unit: Literal["m", "cm", "mm", "ft"] = Field(
        "m", description="unit of the file's coordinates; of a map, that of its heights [-]"
    )
    start: tuple[float, float] | None = Field(
        None, description="x and y at which the line over a map or through a cloud begins [m]"
    )
    end: tuple[float, float] | None = Field(
        None, description="x and y at which that line ends; the robot drives towards it [m]"
    )
    spacing: float = Field(
        0.02, ge=0.005, le=0.5, description="distance between two heights on the line [m]"
    )
    largest_gap: float = Field(
        0.2, ge=0, le=5, description="longest stretch without a height that is bridged [m]"
    )
    resolution: float | None = Field(
        None, gt=0, le=10, description="size of a map's cells, where the file does not say it [m]"
    )
    rows: Literal["+y", "-y"] = Field(
        "+y",
        description="way of the rows of such a map, whose first cell lies at (0, 0) and whose "
        "columns run along x [-]",
    )
    up: Literal["x", "y", "z", "-x", "-y", "-z"] = Field(
        "z",
        description="axis of a cloud's frame that points up; start and end are then in the "
        "other two, as x and y of a right-handed frame [-]",
    )
    thickness: float = Field(
        0.1, gt=0, le=2, description="of the vertical slice through a cloud [m]"
    )
    quantile: float = Field(
        0.9, ge=0, le=1, description="which of a cloud's points at a place is its height [-]"
    )

    @model_validator(mode="after")
    def _stated(self) -> Self:
        suffix = self._file.suffix.lower()
        if suffix not in SUFFIXES:
            raise ValueError(f"path {self.path}: one of {', '.join(SUFFIXES)} is allowed")
        given = [self.start is not None, self.end is not None]
        if suffix == ".csv" and any(given):
            raise ValueError("start and end belong to maps and clouds; a .csv is the line itself")
        if suffix != ".csv" and not all(given):
            raise ValueError(f"a {suffix} file needs start and end, the line over the ground")
        if suffix != ".csv" and self.start == self.end:
            raise ValueError(f"start and end are both {self.start}; the line has no length")
        return self

    def generate(self, rng: np.random.Generator) -> Profile:
        """From x and z of 0 on; nothing is drawn."""
        return self._profile

    @property
    def _file(self) -> Path:
        return EXAMPLE if self.path is None else Path(self.path).expanduser()

    @cached_property
    def _profile(self) -> Profile:
        points = self._points()
        return Profile(points - points[0], self._file.stem)

    def _points(self) -> FloatArray:
        """(V, 2) of x and z [m].

        Raises:
            ValueError: the file is missing, unreadable or does not fit its settings.
        """
        file = self._file
        if not file.is_file():
            raise ValueError(f"{file}: there is no such file")
        try:
            return self._read(file, file.suffix.lower())
        except ImportError as error:
            raise ValueError(
                f"{file}: {file.suffix} files need the package {error.name}; "
                "install flipperctl[profiles]"
            ) from error
        except _UNREADABLE as error:
            raise ValueError(f"{file}: {' '.join(str(error).split())}") from error

    def _read(self, file: Path, suffix: str) -> FloatArray:
        unit = UNITS[self.unit]
        if self.start is None or self.end is None:
            return polyline.read_csv(file) * unit
        line = Line(self.start, self.end, self.spacing)
        if suffix in MAPS:
            rows = 1 if self.rows == "+y" else -1
            found = MAPS[suffix](file, self.resolution, unit, rows).along(line)
        else:
            points = cloud.upright(CLOUDS[suffix](file) * unit, self.up)
            found = cloud.slice_along(points, line, self.thickness, self.quantile, FEWEST)
        return line.profile(found, self.largest_gap)
