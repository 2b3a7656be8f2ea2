"""The planar engine and sensor; importing this package registers both as ``planar``.

``engine`` and ``sensing`` hold settings; pymunk and numba are imported when a robot is placed.
"""

from flipperctl.sim.planar.engine import Planar, planar
from flipperctl.sim.planar.sensing import PlanarSensor, TerrainSensor

__all__ = ["Planar", "PlanarSensor", "TerrainSensor", "planar"]
