"""Built-in measures of episodes: duration, pitch and the motion of the flippers."""

from . import decisions, flipper_travel, max_pitch, pitch_variation, t_cost

__all__ = ["decisions", "flipper_travel", "max_pitch", "pitch_variation", "t_cost"]
