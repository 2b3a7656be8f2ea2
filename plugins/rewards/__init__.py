"""Built-in reward terms: the paper's three, and further ones to compose rewards from."""

from . import (
    clearance,
    end,
    flipper,
    impact,
    pitch,
    progress,
    shaped_progress,
    smoothness,
    stability,
    swing,
    travel,
)

__all__ = [
    "clearance",
    "end",
    "flipper",
    "impact",
    "pitch",
    "progress",
    "shaped_progress",
    "smoothness",
    "stability",
    "swing",
    "travel",
]
