"""The measures of an episode; each is a class in this package and an entry of ``MEASURES``.

Rows, files, summaries and tables show the measures of ``MEASURES`` in this order.
"""

from flipperctl.env.measures.duration import Decisions, Time
from flipperctl.env.measures.flippers import FlipperTravel
from flipperctl.env.measures.measure import Measure
from flipperctl.env.measures.metrics import EpisodeMetrics
from flipperctl.env.measures.pitch import MaxPitch, PitchVariation, PitchVariation100Hz

MEASURES: tuple[type[Measure], ...] = (
    Decisions,
    Time,
    PitchVariation,
    PitchVariation100Hz,
    MaxPitch,
    FlipperTravel,
)

__all__ = ["MEASURES", "EpisodeMetrics", "Measure"]
