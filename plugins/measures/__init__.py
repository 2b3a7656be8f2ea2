"""Built-in measures of episodes: duration, pitch, the motion of the flippers, errors of a map."""

from . import decisions, flipper_travel, mapping, max_pitch, pitch_variation, t_cost

__all__ = ["decisions", "flipper_travel", "mapping", "max_pitch", "pitch_variation", "t_cost"]
