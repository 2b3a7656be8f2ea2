"""Recorded ground: a profile, a height map, a mesh or a point cloud from a file."""

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cached_property, partial
from pathlib import Path
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import FloatArray, Profile, Terrain, terrain

from ..recorded_ground import clouds, geotiff, height_map, polyline
from ..recorded_ground.claims import ply_elements
from ..recorded_ground.clouds import remark_on_rounding
from ..recorded_ground.height_map import HeightMap
from ..recorded_ground.layers import Choice, overhead
from ..recorded_ground.line import Line, RecordedSurface
from ..recorded_ground.mesh import Mesh, read_mesh
from ..recorded_ground.plausible import (
    remarks_on_extent,
    remarks_on_layers,
    remarks_on_missing,
    remarks_on_profile,
    remarks_on_projection,
)
from ..recorded_ground.reading import quiet

UNITS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
MAPS = {".npy": height_map.read_npy, **dict.fromkeys((".tif", ".tiff"), geotiff.read_geotiff)}
CLOUDS = {
    ".pcd": clouds.read_pcd,
    ".ply": clouds.read_ply,
    **dict.fromkeys((".xyz", ".csv"), clouds.read_text),
}
MESHES = (".stl", ".obj", ".dae")
STATING = (".tif", ".tiff", ".dae")
"""Suffixes of files that may state their unit."""
SUFFIXES = tuple(dict.fromkeys((".csv", *MAPS, *MESHES, *CLOUDS)))
MIN_POINTS = 10
"""Smallest number of points in a slice through a cloud [-]."""
MAX_LENGTH = 10_000.0
"""Largest extent of a profile [m]; a larger one suggests a wrong unit."""
BESIDE = 0.4
"""Distance to either side of the line within which unknown ground is reported [m]."""


@terrain("profile_file")
class ProfileFile(Terrain):
    """The same recorded ground each episode; the file's suffix determines its format.

    ``.csv``: columns x (forward) and z (up), x never decreasing; with a line, a point cloud.
    ``.npy``, ``.tif``: a height map; the profile is taken along the line from ``start`` to ``end``.
    ``.stl``, ``.obj``, ``.dae``: a mesh seen from above, along that line.
    ``.pcd``, ``.ply``, ``.xyz``: a point cloud; the profile is a slice along that line. A ``.ply``
    with faces is a mesh.
    One of several layers of a mesh or a cloud, such as a floor and a ceiling, is the ground.
    GeoTIFF, meshes, PCD and PLY need the extra ``profiles``.
    """

    path: str | None = Field(
        None, description="file to read, such as terrain.path=ground.csv; it must be given [-]"
    )
    unit: Literal["m", "dm", "cm", "mm", "in", "ft"] | None = Field(
        None,
        description="unit of the file's coordinates; for a map, of its heights only; null is the "
        "unit that a .dae or a GeoTIFF states, or else m [-]",
    )
    start: tuple[float, float] | None = Field(
        None, description="x and y at which the line over the ground begins [m]"
    )
    end: tuple[float, float] | None = Field(
        None, description="x and y at which that line ends; the robot drives towards it [m]"
    )
    spacing: float = Field(
        0.02, ge=0.005, le=0.5, description="distance between heights along the line [m]"
    )
    largest_gap: float = Field(
        0.2, ge=0, le=5, description="longest distance without heights that is interpolated [m]"
    )
    resolution: float | None = Field(
        None, gt=0, le=10, description="size of a map's cells, if the file does not contain it [m]"
    )
    rows: Literal["+y", "-y"] = Field(
        "+y",
        description="direction of the rows of such a map; its first cell lies at (0, 0) and its "
        "columns run along x [-]",
    )
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = Field(
        None,
        description="axis of a cloud's or mesh's frame that points up; start and end are given in "
        "the other two axes, as x and y of a right-handed frame: with y, the file's (1, 2, 3) is "
        "x = 3, y = 1 and height 2; null is the axis that a .dae states, or else z [-]",
    )
    thickness: float = Field(
        0.1, gt=0, le=2, description="thickness of the vertical slice through a cloud [m]"
    )
    viewpoint: bool | None = Field(
        None,
        description="whether the points of a .pcd are moved by the pose that its VIEWPOINT states; "
        "null leaves them with a warning [-]",
    )
    quantile: float = Field(
        0.9,
        ge=0,
        le=1,
        description="quantile of the cloud's heights that is taken at each place [-]",
    )
    highest: bool = Field(
        False,
        description="whether the highest of several layers of a mesh or cloud, such as a floor and "
        "a ceiling, is the ground instead of the lowest [-]",
    )
    headroom: float = Field(
        1.0,
        gt=0,
        le=10,
        description="free height that the robot needs above a layer of a mesh or cloud; where "
        "there is less, the robot drives on the next layer above [m]",
    )
    no_data: float | None = Field(
        None,
        ge=-1e308,
        le=1e308,
        description="value that marks unknown heights in a map, in its unit; -9999, -99999, "
        "-32767, -32768, 1e20 or more and the value stated in a GeoTIFF always do [-]",
    )
    largest_mesh: int = Field(
        2_000_000, ge=1, le=100_000_000, description="largest number of faces of a mesh [-]"
    )

    @model_validator(mode="after")
    def _check_fields(self) -> Self:
        # The other settings belong to a kind of file.
        if self.path is None:
            return self
        suffix = self._file.suffix.lower()
        if suffix not in SUFFIXES:
            raise ValueError(f"path {self.path}: one of {', '.join(SUFFIXES)} is allowed")
        # Only a .csv may be a profile, which needs no line over the ground.
        stated = [self.start is not None, self.end is not None]
        if not all(stated) and (suffix != ".csv" or any(stated)):
            cells = suffix == ".npy" and self.resolution is None
            raise ValueError(
                f"a {suffix} file needs start and end, the line over the ground in metres: "
                "'terrain.start=[x,y]' 'terrain.end=[x,y]'"
                f"{', and terrain.resolution, the size of its cells' if cells else ''}"
            )
        if suffix != ".pcd" and self.viewpoint is not None:
            raise ValueError(f"viewpoint belongs to .pcd files; path is {self.path}")
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

    @property
    def title(self) -> str:
        """Name of the recorded file, once there is one."""
        return self.plugin_name if self.path is None else Path(self.path).name

    def files_read(self) -> tuple[Path, ...]:
        """Return the recorded file."""
        return (self._file,)

    @property
    def _file(self) -> Path:
        if self.path is None:
            raise ValueError(
                "path: which recorded ground? Name its file, such as terrain.path=ground.csv"
            )
        try:
            return Path(self.path).expanduser()
        except RuntimeError as error:  # there is no such user
            raise ValueError(f"path {self.path}: {error}") from error

    def notices(self) -> tuple[str, ...]:
        """Return remarks on the recording's extent, faces, layers and missing values."""
        _, remarks = self._recorded
        return tuple(f"{self._file}: {remark}" for remark in (*remarks, *self._beside_remark()))

    @cached_property
    def _profile(self) -> Profile:
        points, _ = self._recorded
        surface = None
        if self._kind in ("map", "mesh"):
            height = float(points[0, 1])
            surface = RecordedSurface(points[:, 0], partial(self._beside, height))
        return Profile(points - points[0], surface=surface)

    @cached_property
    def _recorded(self) -> tuple[FloatArray, tuple[str, ...]]:
        """Read the points, (V, 2) of x and z [m], and remarks on them.

        Raises:
            ValueError: the file is missing, unreadable or does not fit the settings.
        """
        remarks: list[str] = []
        with self._naming_file() as file:
            points = self._read(file, file.suffix.lower(), remarks)
        # A wrong unit shows in an extent that no ground has.
        extent = np.ptp(points, axis=0)
        if not (np.isfinite(points).all() and extent.max() <= MAX_LENGTH):
            raise ValueError(
                f"{file}: it covers {extent[0]:g} m in x and {extent[1]:g} m in z; up to "
                f"{MAX_LENGTH:g} m is allowed: {self._remedy}"
            )
        layered = self._kind in ("mesh", "cloud")
        remarks += remarks_on_profile(points - points[0], self._remedy, layered)
        return points, tuple(remarks)

    @property
    def _remedy(self) -> str:
        if self._file.suffix.lower() in STATING and self.unit is None:
            return "it is in the unit that it states, or else in m; terrain.unit states another"
        return f"terrain.unit={self.unit or 'm'} is set, another unit may be right"

    @property
    def _metres(self) -> float:
        """Unit of a file that does not state its own [m]."""
        return UNITS[self.unit or "m"]

    @cached_property
    def _kind(self) -> Literal["profile", "map", "mesh", "cloud"]:
        """What the file holds; a .ply may hold faces."""
        suffix = self._file.suffix.lower()
        if self.start is None:
            return "profile"
        if suffix == ".ply":
            elements = ply_elements(self._file)
            if not elements.get("vertex"):
                raise ValueError("its header states no vertices")
            if elements.get("tristrips"):
                raise ValueError("its triangle strips are not read; save it with faces")
            return "mesh" if elements.get("face") else "cloud"
        return "map" if suffix in MAPS else "mesh" if suffix in MESHES else "cloud"

    def _read(self, file: Path, suffix: str, remarks: list[str]) -> FloatArray:
        # Without a line, the file itself is a profile.
        if self.start is None or self.end is None:
            unit = self._metres
            points, more = polyline.read_csv(file, self.largest_gap / unit, self.thickness / unit)
            remarks += more
            remarks += remarks_on_extent(np.ptp(points, axis=0) * unit, self._remedy)
            return points * unit
        # A cloud is cut along the line; maps and meshes have ground beside it as well.
        line = Line(self.start, self.end, self.spacing)
        if self._kind == "cloud":
            return self._along_cloud(file, line, remarks)
        ground = self._ground(file)
        unknown = "no height is known"
        remedy = self._remedy if suffix not in MAPS else "check resolution, start and end"
        remarks += ground.remarks
        remarks += remarks_on_extent(ground.extent, remedy)
        if isinstance(ground, HeightMap):
            line = ground.on_ground(line)
            remarks += remarks_on_projection(line)
            heights, remark = ground.along(line)
            remarks += [remark] if remark else []
            remarks += remarks_on_missing(heights)
        else:
            unknown = "the mesh is not closed"
            if suffix == ".ply":
                unknown += " (without faces, a .ply is a cloud)"
            corners = ground.corners.reshape(-1, 3)
            rounded = remark_on_rounding(corners, "", 1.0, self.spacing)
            remarks += [rounded] if rounded else []
            layers = ground.along(line)
            heights = layers.height
            remarks += remarks_on_layers(layers, self._choice)
        return line.profile(heights, self.largest_gap, unknown)

    def _along_cloud(self, file: Path, line: Line, remarks: list[str]) -> FloatArray:
        points, more = clouds.measured(
            CLOUDS[file.suffix.lower()](file),
            self._metres,
            self.up or "z",
            self.viewpoint,
            self.spacing,
        )
        remarks += more
        if len(points):
            remarks += remarks_on_extent(np.ptp(points, axis=0), self._remedy)
        try:
            # What hangs over ground that was not seen is no ground.
            ground = clouds.slice_along(
                points, line, self.thickness, self.quantile, MIN_POINTS, self._choice
            )
            margin = self.thickness / 2 + self.spacing
            hanging = overhead(ground, line.distances, self._choice, margin)
            remarks += remarks_on_layers(ground, self._choice, hanging)
            return line.profile(np.where(hanging, np.nan, ground.height), self.largest_gap)
        except ValueError as error:  # which a remark on the file may explain
            raise ValueError("; ".join([str(error), *more])) from error

    @property
    def _choice(self) -> Choice:
        return Choice(self.headroom, self.highest, self.largest_gap)

    def _ground(self, file: Path) -> HeightMap | Mesh:
        """Return the map or the mesh, which has heights beside the line too."""
        suffix, unit = file.suffix.lower(), UNITS[self.unit] if self.unit else None
        if self._kind == "mesh":
            return read_mesh(file, unit, self.up, self.largest_mesh, self._choice)
        rows = 1 if self.rows == "+y" else -1
        return MAPS[suffix](file, self.resolution, unit, rows, self.no_data)

    def _beside_remark(self) -> Iterator[str]:
        """Yield a remark if a map is unknown where the robot's sides drive."""
        if self._file.suffix.lower() not in MAPS:
            return
        with suppress(ValueError):  # such as too many cells
            heights = self._beside(0.0, np.linspace(-BESIDE, BESIDE, 9))
            if count := int(np.isnan(heights).any(axis=1).sum()):
                yield (
                    f"within {BESIDE:g} m of the line heights are unknown at {count} of "
                    f"{len(heights)} places; the side plane drives on the line alone, engines in "
                    "3-D may refuse it"
                )

    def _beside(self, height: float, y: FloatArray) -> FloatArray:
        """Return the heights above ``height`` at all points of the line and at ``y``, (D, Y) [m].

        Raises:
            ValueError: the file cannot be read.
        """
        assert self.start is not None
        assert self.end is not None
        line = Line(self.start, self.end, self.spacing)
        with self._naming_file() as file:
            ground = self._ground(file)
            if isinstance(ground, HeightMap):
                line = ground.on_ground(line)
            heights = ground.beside(line, line.distances, y)
        columns = [line.bridged(column, self.largest_gap) for column in heights.T]
        return np.column_stack(columns) - height

    @contextmanager
    def _naming_file(self) -> Iterator[Path]:
        """Turn exceptions of the file's reader into a ValueError that names the file."""
        file = self._file
        try:
            with file.open("rb"):  # raises the system's own message if the file cannot be read
                pass
            with quiet():
                yield file
        except ImportError as error:
            raise ValueError(
                f"{file}: {file.suffix} files need {error.name}: pip install 'flipperctl[profiles]'"
            ) from error
        except FileNotFoundError as error:
            place = "" if file.is_absolute() else f" in {Path.cwd()}"
            raise ValueError(f"{file}: there is no such file{place}") from error
        except Exception as error:  # on a damaged file, a reader may raise any exception
            reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
            raise ValueError(f"{file}: {' '.join(str(reason).split())[:500]}") from error
