"""Why episodes failed: the sensing, by playing them again with less of its error, or the robot.

In: failed episodes, their configuration and policy. Out: the cause of each failure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import StrEnum

from flipperctl.api import Outcome, RobotState
from flipperctl.config import EvalConfig, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.evaluation.rows import CAUSE, END, Row, reached
from flipperctl.plugging.checked import require
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Decision
from flipperctl.rollout.episode import play as drive

_OFF_HEADING = math.radians(30)  # heading beyond which a stopped robot is off course [rad]
_OFF_SIDE = 1.0  # lateral distance beyond which a stopped robot is off course [m]
_MAX_FRICTION = 10.0  # largest friction that is tried [-]
_FRICTION_FACTOR = 2.0
"""Factor on friction that distinguishes a lack of traction from an obstacle [-]."""


class Cause(StrEnum):
    """Why an episode failed."""

    DRIFT = "drift"
    """The robot reaches the finish with the true pose and the same sensor otherwise."""
    PERCEPTION = "perception"
    """The robot reaches the finish on the true ground, and not with the true pose alone."""
    OTHER = "other"
    """The robot fails on the true ground too; where engines are compared, it is one of these:"""
    OVERTURNED = "overturned"
    """The robot fell over forwards or backwards."""
    ROLL = "roll"
    """The robot fell over sideways."""
    HEADING = "heading"
    """The robot turned away or left the ground sideways."""
    TRACTION = "traction"
    """The robot stopped, but reaches the finish with twice the friction."""
    STUCK = "stuck"
    """The robot stopped, even with twice the friction."""


def on_true_ground(config: EvalConfig) -> EvalConfig | None:
    """Return the configuration with the true ground and posture in place of the sensor.

    None if the sensor is already exact, or if one of its settings is randomised (dropping it would
    shift the other draws).
    """
    perception = require(config.perception, "exact", config.perception.exact())
    sampled = any(setting.section == "perception" for setting in config.randomise.sampled())
    if type(perception) is type(config.perception) or sampled:
        return None
    return config.model_copy(update={"perception": perception})


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
) -> dict[int, Cause]:
    """Return the cause of each failed episode by its index; nothing for other sensors.

    ``play`` plays the episodes with these indices under a configuration; what it leaves out, since
    it was interrupted, is left out.
    """
    exactly, posed = on_true_ground(config), at_true_pose(config)
    if not failed or exactly is None:
        return {}
    left = [row["episode"] for row in failed]
    cause_of: dict[int, Cause] = {}
    # The true pose comes first, since it may be enough.
    if posed is not None:
        drifted = [row["episode"] for row in play(posed, left) if reached(row)]
        cause_of = dict.fromkeys(drifted, Cause.DRIFT)
        left = [index for index in left if index not in cause_of]
    # What the true ground mends was perceived wrongly.
    for row in play(exactly, left) if left else ():
        cause_of[row["episode"]] = Cause.PERCEPTION if reached(row) else Cause.OTHER
    return dict(sorted(cause_of.items()))


def explain(config: EvalConfig, source: PolicySource, row: Row) -> Row:
    """Play a failed episode again; return its cause and the robot's posture at its end."""
    states: list[RobotState] = []

    def watch(decision: Decision) -> None:
        states[:] = [decision.transition.after]

    drive(FlipperEnv(config=config), source.build(config), row["seed"], watch=watch)
    (end,) = states
    # On known ground, how the episode ended says what went wrong.
    cause = Cause(row.get("failed_by", Cause.OTHER))
    if cause is Cause.OTHER:
        cause = _cause(end, row["outcome"], config)
        more = with_friction(config) if cause is Cause.STUCK else None
        if more and reached(drive(FlipperEnv(config=more), source.build(more), row["seed"])):
            cause = Cause.TRACTION
    posture = float(end.position[0]), end.pitch, end.roll, end.yaw, end.side
    return {CAUSE: str(cause), **dict(zip(END.values(), posture, strict=True))}


def _cause(end: RobotState, outcome: str, config: EvalConfig) -> Cause:
    overturn = config.episode.overturn
    if outcome == Outcome.OVERTURNED:
        if abs(end.pitch) >= overturn:
            return Cause.OVERTURNED
        limit = config.sim.shared_setting("roll_limit")
        rolled = abs(end.roll) >= (overturn if limit is None else limit)
        return Cause.ROLL if rolled else Cause.HEADING
    astray = abs(end.yaw) > _OFF_HEADING or abs(end.side) > _OFF_SIDE
    return Cause.HEADING if astray else Cause.STUCK


def with_friction(config: EvalConfig) -> EvalConfig | None:
    """Return the configuration with twice the friction; None if the engine has no such setting."""
    friction = config.sim.shared_setting("friction")
    if friction is None:
        return None
    sampled = config.randomise.find("sim", "friction")
    changed: dict[str, object] = {"sim.friction": min(_MAX_FRICTION, _FRICTION_FACTOR * friction)}
    if sampled is not None:  # with randomise.spread, samples lie between the friction and the ends
        changed[sampled.key] = [min(_MAX_FRICTION, _FRICTION_FACTOR * mu) for mu in sampled.ends]
    try:
        return with_overrides(config, changed)
    except ConfigError:  # beyond the engine's bounds
        return None
