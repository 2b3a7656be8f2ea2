"""Which failed episodes are due to the sensing: they are played again with less of its error.

In: failed episodes under a sensor that maps the ground. Out: the cause of each failure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum

from flipperctl.config import EvalConfig, with_overrides
from flipperctl.env.guarded_sensor import exact
from flipperctl.errors import ConfigError
from flipperctl.evaluation.rows import Row, reached


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

    None if the sensor is already exact, or if one of its settings is randomised (dropping it would
    shift the other draws).
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
    failed: Sequence[Row],
    play: Callable[[EvalConfig, Sequence[int]], Sequence[Row]],
    true_ground: Sequence[Row] | None = None,
) -> dict[int, SensingCause]:
    """Return the cause of each failed episode by its index; nothing for other sensors.

    ``play`` plays the episodes with these indices under a configuration. ``true_ground``: the same
    episodes on the true ground, if they have been played already. Episodes that ``play`` leaves
    out, since it was interrupted, are left out.
    """
    exactly, posed = on_true_ground(config), at_true_pose(config)
    if not failed or exactly is None:
        return {}
    left = [row["episode"] for row in failed]
    found: dict[int, SensingCause] = {}
    if posed is not None:
        drifted = [row["episode"] for row in play(posed, left) if reached(row)]
        found = dict.fromkeys(drifted, SensingCause.DRIFT)
        left = [index for index in left if index not in found]
    known = [row for row in true_ground or () if row["episode"] in left]
    for row in known if true_ground is not None or not left else play(exactly, left):
        found[row["episode"]] = SensingCause.PERCEPTION if reached(row) else SensingCause.OTHER
    return dict(sorted(found.items()))


def counts(episodes: Iterable[Row]) -> dict[str, int]:
    """Return the number of failures by cause, the most frequent first; empty if none is known."""
    return dict(Counter(row["failed_by"] for row in episodes if "failed_by" in row).most_common())
