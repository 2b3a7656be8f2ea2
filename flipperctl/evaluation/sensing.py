"""Which failed episodes are due to the sensing: they are played again with less of its error.

In: failed episodes under a sensor that maps the ground. Out: the cause of each failure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum

from flipperctl.config import EvalConfig, with_overrides
from flipperctl.env.sensing import exact
from flipperctl.errors import ConfigError
from flipperctl.evaluation.episode import EpisodeResult

Play = Callable[[EvalConfig, Sequence[int]], Sequence[EpisodeResult]]
"""Plays the episodes with these indices under a configuration."""


class SensingCause(StrEnum):
    """What a failure is due to, by repeating the episode."""

    DRIFT = "drift"
    """The robot reaches the finish with the true pose and the same sensor otherwise."""
    PERCEPTION = "perception"
    """The robot reaches the finish on the true ground, and not with the true pose alone."""
    OTHER = "other"
    """The robot fails on the true ground too."""


def on_true_ground(config: EvalConfig) -> EvalConfig | None:
    """Return the configuration with the true ground and posture in place of the sensor.

    None: the sensor is itself that of the true ground, apart from its settings, or a setting of it
    is sampled, without which other values would be sampled differently.
    """
    found = exact(config.perception)
    sampled = any(one.section == "perception" for one in config.randomise.sampled())
    if type(found) is type(config.perception) or sampled:
        return None
    return config.model_copy(update={"perception": found})


def at_true_pose(config: EvalConfig) -> EvalConfig | None:
    """Return the configuration with the sensor's odometry replaced by the true pose.

    None: the sensor has no setting ``pose`` that can be ``true``, or it is ``true`` already.
    """
    if getattr(config.perception, "pose", "true") == "true":
        return None
    try:
        return with_overrides(config, {"perception.pose": "true"})
    except ConfigError:  # a plugin's setting of that name has another meaning
        return None


def causes(
    config: EvalConfig,
    failed: Sequence[EpisodeResult],
    play: Play,
    true_ground: Sequence[EpisodeResult] | None = None,
) -> dict[int, SensingCause]:
    """Return the cause of each failed episode by its index; nothing for other sensors.

    ``true_ground``: the same episodes on the true ground, if they have been played already.
    Episodes that ``play`` leaves out, since it was interrupted, are left out.
    """
    exactly, posed = on_true_ground(config), at_true_pose(config)
    if not failed or exactly is None:
        return {}
    left = [e.episode for e in failed]
    found: dict[int, SensingCause] = {}
    if posed is not None:
        found = dict.fromkeys(_reached(play(posed, left)), SensingCause.DRIFT)
        left = [index for index in left if index not in found]
    known = [e for e in true_ground or () if e.episode in left]
    played = known if true_ground is not None or not left else play(exactly, left)
    crossed = _reached(played)
    for e in played:
        cause = SensingCause.PERCEPTION if e.episode in crossed else SensingCause.OTHER
        found[e.episode] = cause
    return dict(sorted(found.items()))


def counts(episodes: Iterable[EpisodeResult]) -> dict[str, int]:
    """Return the number of failures by cause, the most frequent first; empty if none is known."""
    return dict(Counter(e.failed_by for e in episodes if e.failed_by is not None).most_common())


def _reached(episodes: Sequence[EpisodeResult]) -> set[int]:
    return {e.episode for e in episodes if e.reached}
