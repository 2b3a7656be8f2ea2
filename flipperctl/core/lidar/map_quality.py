"""The settings of a LiDAR's map that a robot's controller takes over from the training.

In: settings of the training, or the metadata of a policy's file. Out: ``MapSettings``. Simulator
and robot share this definition.
"""

from __future__ import annotations

from dataclasses import dataclass

from flipperctl.core.lidar.cells import Grid
from flipperctl.core.lidar.certainty import Accuracy
from flipperctl.core.lidar.ground import MapSettings

MEANING = (
    "map of the ground in which the policy was trained: lengths cell along and lane across the "
    "way, half_width to each side and noise of a point's height in m, keep points a cell, fewest "
    "points of a column that is seen; deskew: points are corrected for the motion within a scan"
)
"""The settings in words, for the metadata of exported policies."""


@dataclass(frozen=True)
class MapQuality:
    """How the points of scans make up the ground; the defaults are those of ``MapSettings``."""

    cell: float = Grid.cell
    """Length of the map's cells along the way [m]."""
    lane: float = Grid.lane
    """Width of the map's cells [m]."""
    keep: int = Grid.keep
    """Newest points that a cell holds [-]."""
    half_width: float = MapSettings.half_width
    """Ground within this distance beside the robot's line counts [m]."""
    fewest: int = MapSettings.fewest
    """Points without which a column of cells is unseen [-]."""
    noise: float = MapSettings.noise
    """Standard deviation of the height of a point [m]."""
    deskew: bool = True
    """Whether points are corrected for the robot's motion within a scan."""

    def settings(
        self, bins: int, bin_width: float, accuracy: Accuracy, *, sides: bool
    ) -> MapSettings:
        """Return the settings of a map in this layout; see ``MapSettings`` for the arguments."""
        return MapSettings(
            bins=bins,
            bin_width=bin_width,
            grid=Grid(cell=self.cell, lane=self.lane, keep=self.keep),
            half_width=self.half_width,
            fewest=self.fewest,
            noise=self.noise,
            accuracy=accuracy,
            sides=sides,
        )
