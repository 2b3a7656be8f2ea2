"""Built-in measures of episodes: duration, pitch, flippers, stability, impacts, roll, maps."""

from . import (
    decisions,
    energy_margin,
    flipper_energy,
    flipper_travel,
    largest_impact,
    mapping,
    max_pitch,
    pitch_reserve,
    pitch_variation,
    roll,
    standstill,
    t_cost,
)

__all__ = [
    "decisions",
    "energy_margin",
    "flipper_energy",
    "flipper_travel",
    "largest_impact",
    "mapping",
    "max_pitch",
    "pitch_reserve",
    "pitch_variation",
    "roll",
    "standstill",
    "t_cost",
]
