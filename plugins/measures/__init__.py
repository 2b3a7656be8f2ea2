"""Built-in measures of episodes: duration, pitch, flippers, stability, impacts, maps, operation."""

from . import energy_margin, mapping, motion, operation

__all__ = ["energy_margin", "mapping", "motion", "operation"]
