"""The planar engine and sensor; importing this package registers both as ``planar``.

Placing a robot imports pymunk and numba.
"""

from flipperctl.sim.planar.engine import Planar
from flipperctl.sim.planar.sensing import PlanarSensor, TerrainSensor

__all__ = ["Planar", "PlanarSensor", "TerrainSensor"]
