"""Episode results made by hand."""

from typing import Any

from flipperctl.api import Outcome
from flipperctl.evaluation.episode import EpisodeResult


def sample(seed: int, outcome: str, value: float, terrain: str = "step", **more: Any) -> Any:
    """Return an episode whose θ̂_R is ``value`` [rad], at 100 Hz twice, its t_cost ten times [s]."""
    fields = {
        "decisions": 20,
        "t_cost": 10 * value,
        "pitch_variation": value,
        "pitch_variation_100hz": 2 * value,
        "max_pitch": 0.1 * value,
        "flipper_travel": 3 * value,
        "episode_return": -value,
        "rewards": {"pitch": -value},
        "sampled": {"start_shift": 0.01},
    }
    return EpisodeResult(seed, seed, Outcome(outcome), terrain, **{**fields, **more})
