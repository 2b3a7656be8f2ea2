"""Explain the failures of a policy in another engine.

In: a failed episode. Out: its cause, and the robot's posture at its end. The episode is played
again to observe it; its seed repeats it bit for bit.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from flipperctl.api import Outcome, RobotState
from flipperctl.config import EvalConfig, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.sensing import SensingCause
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Decision, play

_OFF_HEADING = math.radians(30)
"""Heading beyond which a stopped robot is off course [rad]."""
_OFF_SIDE = 1.0
"""Lateral distance beyond which a stopped robot is off course [m]."""
_MAX_FRICTION = 10.0
"""Largest friction that is tried [-]."""
_FRICTION_FACTOR = 2.0
"""Factor on friction that distinguishes a lack of traction from an obstacle [-]."""


class Cause(StrEnum):
    """Why an episode failed."""

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
    DRIFT = SensingCause.DRIFT.value
    """The robot reaches the finish with the true pose in place of the sensor's odometry."""
    PERCEPTION = SensingCause.PERCEPTION.value
    """The robot reaches the finish on the true ground, and not with the true pose alone."""


@dataclass(frozen=True)
class Failure:
    """An episode that fails in the other engine."""

    episode: int
    seed: int
    terrain: str
    """Label of the sampled profile."""
    outcome: Outcome
    cause: Cause
    default_outcome: Outcome
    """Outcome of the same episode in the default engine."""
    time: float
    """Time at the end [s]."""
    x: float
    """World x of the chassis centre at the end [m]."""
    pitch: float
    roll: float
    yaw: float
    """Posture at the end [rad]."""
    side: float
    """Lateral distance from the middle of the ground at the end [m]."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)


def explain(
    config: EvalConfig,
    source: PolicySource,
    default: EpisodeResult,
    failed: EpisodeResult,
    sensing: SensingCause = SensingCause.OTHER,
) -> Failure:
    """Replay a failed episode and return its cause, which is ``sensing`` unless that is OTHER."""
    end = _end(config, source, failed.seed)
    blamed = sensing is not SensingCause.OTHER
    cause = Cause(sensing.value) if blamed else _cause(end, failed.outcome, config)
    if cause is Cause.STUCK and _reached_with_friction(config, source, failed.seed):
        cause = Cause.TRACTION
    return Failure(
        failed.episode,
        failed.seed,
        failed.terrain,
        failed.outcome,
        cause,
        default.outcome,
        time=end.time,
        x=float(end.position[0]),
        pitch=end.pitch,
        roll=end.roll,
        yaw=end.yaw,
        side=end.side,
    )


def _end(config: EvalConfig, source: PolicySource, seed: int) -> RobotState:
    """Play an episode; return the state at its end."""
    states: list[RobotState] = []

    def watch(decision: Decision) -> None:
        states[:] = [decision.transition.after]

    env = FlipperEnv(config=config)
    play(env, source.build(config), seed, watch=watch)
    return states[0]


def _cause(end: RobotState, outcome: Outcome, config: EvalConfig) -> Cause:
    overturn = config.episode.overturn
    if outcome is Outcome.OVERTURNED:
        if abs(end.pitch) >= overturn:
            return Cause.OVERTURNED
        limit = config.sim.shared_setting("roll_limit")
        rolled = abs(end.roll) >= (overturn if limit is None else limit)
        return Cause.ROLL if rolled else Cause.HEADING
    astray = abs(end.yaw) > _OFF_HEADING or abs(end.side) > _OFF_SIDE
    return Cause.HEADING if astray else Cause.STUCK


def _reached_with_friction(config: EvalConfig, source: PolicySource, seed: int) -> bool:
    """Return whether the episode reaches the finish with more friction."""
    changed = with_friction(config)
    if changed is None:
        return False
    env = FlipperEnv(config=changed)
    row = play(env, source.build(changed), seed)
    return Outcome(row["outcome"]) is Outcome.REACHED


def with_friction(config: EvalConfig) -> EvalConfig | None:
    """Return the configuration with twice the friction; None if the engine has no such setting."""
    own = config.sim.shared_setting("friction")
    if own is None:
        return None
    sampled = config.randomise.find("sim", "friction")
    changed: dict[str, object] = {"sim.friction": min(_MAX_FRICTION, _FRICTION_FACTOR * own)}
    if sampled is not None:  # with randomise.spread, samples lie between the friction and the ends
        changed[sampled.key] = [min(_MAX_FRICTION, _FRICTION_FACTOR * mu) for mu in sampled.ends]
    try:
        return with_overrides(config, changed)
    except ConfigError:  # beyond the engine's bounds
        return None
