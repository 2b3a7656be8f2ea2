"""Built-in measures of episodes: duration, pitch, flippers, stability, impacts, roll, maps."""

from . import energy_margin, mapping, motion

__all__ = ["energy_margin", "mapping", "motion"]
