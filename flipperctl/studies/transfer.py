"""Evaluate a policy in the default engine and in another one, and explain its failures there.

In: an evaluation's configuration in the other engine, and a policy. Out: the summaries of both, the
differences at equal seeds, and the cause of each failure. A failed episode is replayed to observe
it; its seed repeats it bit for bit.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any

from flipperctl.api import Outcome, RobotState
from flipperctl.config import DEFAULT_ENGINE, EvalConfig, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.evaluation.comparisons import correct_together
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.estimates import PairedSuccess
from flipperctl.evaluation.judging import Progress, no_progress, play_scene
from flipperctl.evaluation.results import Differences, Summary
from flipperctl.evaluation.scenes import Scene
from flipperctl.evaluation.statistics import differences, summarise
from flipperctl.evaluation.workers import EpisodeWorkers
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Decision, play
from flipperctl.studies.engines import in_default_engine

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


@dataclass(frozen=True)
class TransferResult:
    """A policy on one terrain in two engines."""

    controller: str
    """Label of the policy."""
    terrain: str
    engines: tuple[str, str]
    seed: int
    """Seed of the evaluation."""
    conditions: Conditions
    """Conditions of the other engine."""
    default: Summary
    other: Summary
    kept: float | None
    """Fraction of the episodes crossed in the default engine that are crossed in the other one."""
    gap: Differences
    """The other engine minus the default one: success, and measures where both reached the
    finish."""
    failures: tuple[Failure, ...]

    @property
    def success_gap(self) -> PairedSuccess:
        """Success in the other engine minus that in the default one, paired by seed [-]."""
        return self.gap.success

    @property
    def causes(self) -> dict[str, int]:
        """Number of failures by cause, the most frequent first."""
        return dict(Counter(str(f.cause) for f in self.failures).most_common())

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        first, second = self.engines
        return {
            "terrain": self.terrain,
            "controller": self.controller,
            "engines": [first, second],
            "seed": self.seed,
            "conditions": self.conditions.to_dict(),
            first: self.default.to_dict(),
            second: self.other.to_dict(),
            "success_gap": self.success_gap.to_dict(),
            "kept": self.kept,
            "gap": self.gap.to_dict(),
            "causes": self.causes,
            "failures": [failure.to_dict() for failure in self.failures],
        }


def transfer(
    config: EvalConfig,
    source: PolicySource,
    workers: EpisodeWorkers,
    *,
    only: Sequence[int] | None = None,
    progress: Progress = no_progress,
) -> TransferResult:
    """Play the evaluation's episodes in the default engine and in ``config``'s.

    ``workers`` play the episodes, those with the indices ``only``; None means all.

    Raises:
        ConfigError: ``config`` uses the default engine.
        FlipperctlError: the policy cannot be built or failed.
    """
    plane = in_default_engine(config)
    terrain, engines = config.terrain.plugin_name, (DEFAULT_ENGINE, config.sim.plugin_name)
    ours, theirs = (
        play_scene(chosen, source, f"{terrain}, {engine}", workers, progress, only)
        for chosen, engine in zip((plane, config), engines, strict=True)
    )
    pairs = list(zip(ours, theirs, strict=True))
    crossed = [other.reached for first, other in pairs if first.reached]
    return TransferResult(
        source.label(),
        terrain,
        engines,
        config.eval.seed,
        Conditions.of(config),
        summarise(terrain, ours),
        summarise(terrain, theirs),
        sum(crossed) / len(crossed) if crossed else None,
        differences(theirs, ours),
        tuple(explain(config, source, *pair) for pair in pairs if not pair[1].reached),
    )


def transfer_scenes(
    scenes: Sequence[Scene],
    workers: EpisodeWorkers,
    only: int | None = None,
    progress: Progress = no_progress,
) -> list[TransferResult]:
    """Return the result of each scene, its tests corrected for all; ``only``: of one episode."""
    chosen = None if only is None else [only]
    return correct_scenes(
        [transfer(c, source, workers, only=chosen, progress=progress) for c, source in scenes]
    )


def correct_scenes(found: Sequence[TransferResult]) -> list[TransferResult]:
    """Return the results with the p-values of success corrected across scenes."""
    gaps = correct_together([one.gap for one in found])
    return [replace(one, gap=gap) for one, gap in zip(found, gaps, strict=True)]


def explain(
    config: EvalConfig, source: PolicySource, default: EpisodeResult, failed: EpisodeResult
) -> Failure:
    """Replay a failed episode and return its cause."""
    end = _end(config, source, failed.seed)
    cause = _cause(end, failed.outcome, config)
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
    own = config.sim.shared_setting("friction")
    if own is None:
        return False
    sampled = config.randomise.find("sim", "friction")
    changed: dict[str, object] = {"sim.friction": min(_MAX_FRICTION, _FRICTION_FACTOR * own)}
    if sampled is not None:
        changed = {sampled.key: [min(_MAX_FRICTION, _FRICTION_FACTOR * mu) for mu in sampled.ends]}
    try:
        config = with_overrides(config, changed)
    except ConfigError:  # beyond the engine's bounds
        return False
    env = FlipperEnv(config=config)
    row = play(env, source.build(config), seed)
    return Outcome(row["outcome"]) is Outcome.REACHED
