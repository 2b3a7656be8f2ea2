"""Built-in reward terms: the paper's three, and a library to compose others from."""

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
    "travel",
]
