"""Compare two engines on the same commanded actions.

In: an evaluation's configuration in one engine, and a policy. Out: for each episode, the outcomes,
times and pitches of both engines. The policy acts in the default engine, that of the side plane;
the other engine repeats its actions regardless of their effect, so that only physics differs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

import numpy as np

from flipperctl.api import (
    FloatArray,
    Outcome,
    Perception,
    Policy,
    SharedSetting,
    Simulator,
    action_index,
)
from flipperctl.config import DEFAULT_ENGINE, EnvConfig, EvalConfig, resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.play import Progress, no_progress
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Row, decisions
from flipperctl.rollout.seeds import EvaluationSeeds

PITCH_TOLERANCE = 0.05
"""Largest RMS difference of the pitches at equal times that counts as equal [rad]."""
TIME_TOLERANCE = 0.03
"""Largest relative difference of the times to the finish that counts as equal [-]."""
_ALONG = 0.002
"""Distance between places at which pitches are compared, as driven in one sample [m]."""

_SHARED: tuple[SharedSetting, ...] = ("friction", "gravity")
"""Settings that the default engine takes from the other one."""
Config = TypeVar("Config", bound=EnvConfig)


@dataclass(frozen=True)
class EngineEpisode:
    """One episode, played in the default engine and repeated in the other one."""

    episode: int
    """Index of the episode in the evaluation, from 0."""
    seed: int
    terrain: str
    """Label of the sampled profile."""
    outcomes: tuple[Outcome, Outcome]
    """Outcomes in the default engine and in the other one."""
    times: tuple[float, float]
    """Times to the end of the episode [s]."""
    swings: tuple[float, float]
    """θ̂_R at 100 Hz [rad]."""
    pitch_rms: float
    """RMS difference of the pitches at equal times, until the first one ends [rad]."""
    pitch_rms_along: float
    """The same at equal x, each at its first crossing; a mere delay does not change it [rad]."""
    parts_at: tuple[float, float] | None
    """Time [s] and x [m] from which the pitches differ by more than ``PITCH_TOLERANCE``; None if
    they never do."""

    @property
    def equal_outcomes(self) -> bool:
        """Whether both engines lead to the same outcome."""
        return self.outcomes[0] is self.outcomes[1]

    @property
    def both_reached(self) -> bool:
        """Whether the finish was reached in both."""
        return self.equal_outcomes and self.outcomes[0] is Outcome.REACHED

    @property
    def time_ratio(self) -> float:
        """Time in the other engine divided by that in the default one, minus 1 [-]."""
        return self.times[1] / self.times[0] - 1.0

    @property
    def agrees(self) -> bool:
        """Whether outcomes, times and pitches are equal within the tolerances."""
        near = self.pitch_rms <= PITCH_TOLERANCE and abs(self.time_ratio) <= TIME_TOLERANCE
        return self.equal_outcomes and (near or not self.both_reached)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {**asdict(self), "agrees": self.agrees}


@dataclass(frozen=True)
class EngineComparison:
    """Two engines on one terrain."""

    terrain: str
    controller: str
    """Label of the policy whose actions were repeated."""
    engines: tuple[str, str]
    seed: int
    """Seed of the evaluation."""
    conditions: Conditions
    """Conditions of the other engine."""
    episodes: tuple[EngineEpisode, ...]

    @property
    def reached(self) -> list[EngineEpisode]:
        """Episodes in which both reached the finish."""
        return [e for e in self.episodes if e.both_reached]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        reached = self.reached
        return {
            "terrain": self.terrain,
            "controller": self.controller,
            "engines": list(self.engines),
            "seed": self.seed,
            "conditions": self.conditions.to_dict(),
            "equal_outcomes": sum(e.equal_outcomes for e in self.episodes) / len(self.episodes),
            "agree": sum(e.agrees for e in self.episodes) / len(self.episodes),
            "pitch_rms": mean(e.pitch_rms for e in reached),
            "time_ratio": mean(e.time_ratio for e in reached),
            "episodes": [e.to_dict() for e in self.episodes],
        }


def mean(values: Any) -> float | None:
    """Return the mean of some numbers; None if there are none."""
    found = list(values)
    return sum(found) / len(found) if found else None


def in_default_engine(config: Config) -> Config:
    """Return the configuration in the default engine, with the same friction and gravity.

    Raises:
        ConfigError: the configuration already uses that engine, or samples what it does not have.
    """
    sim = config.sim
    if sim.plugin_name == DEFAULT_ENGINE:
        raise ConfigError(
            f"sim: sim={DEFAULT_ENGINE} is the engine to compare with; "
            "choose another one, such as sim=mujoco"
        )
    known = {name: sim.shared_setting(name) for name in _SHARED}
    shared: dict[str, Any] = {name: value for name, value in known.items() if value is not None}
    plane = resolver.create("sim", {"name": DEFAULT_ENGINE, **shared}, "sim")
    sampled = (one for one in config.randomise.sampled() if one.section == "sim")
    if foreign := [one.key for one in sampled if one.field not in type(plane).model_fields]:
        raise ConfigError(
            f"{', '.join(foreign)}: sim={DEFAULT_ENGINE}, the engine to compare with, has no such "
            f"setting; add {' '.join(f'{key}=null' for key in foreign)}"
        )
    return config.model_copy(update={"sim": plane})


def compare_scenes(
    scenes: Sequence[tuple[EvalConfig, PolicySource]], progress: Progress = no_progress
) -> list[EngineComparison]:
    """Compare the engines on every scene.

    Raises:
        ConfigError: a scene's engine is the default one, found before the first episode, or as for
            ``compare_engines``.
    """
    for config, _ in scenes:
        in_default_engine(config)
    found = []
    for config, source in scenes:
        with progress(config.terrain.plugin_name, config.eval.episodes) as report:
            found.append(compare_engines(config, source, report))
    return found


def compare_engines(
    config: EvalConfig,
    source: PolicySource,
    report: Callable[[float], None] = lambda done: None,
) -> EngineComparison:
    """Play the evaluation's episodes in the default engine and repeat them in ``config``'s.

    ``report`` is called with the number of finished episodes.

    Raises:
        ConfigError: ``config`` uses the default engine.
        FlipperctlError: the policy cannot be built or failed.
    """
    first, second = FlipperEnv(config=in_default_engine(config)), FlipperEnv(config=config)
    policy = source.build(config)
    seeds, found = EvaluationSeeds.of(config.eval.seed, config.terrain), []
    for index in range(config.eval.episodes):
        seed = seeds(index)
        actions, ours, row = _play(first, policy, seed)
        _, theirs, other = _play(second, _Repeat(actions), seed)
        found.append(_episode(index, (row, other), (ours, theirs)))
        report(index + 1.0)
    return EngineComparison(
        config.terrain.plugin_name,
        source.label(),
        (DEFAULT_ENGINE, config.sim.plugin_name),
        config.eval.seed,
        Conditions.of(config),
        tuple(found),
    )


class _Repeat:
    """A policy that repeats given actions and then holds the flippers."""

    def __init__(self, actions: Sequence[int]) -> None:
        self._actions = actions

    def reset(self, simulator: Simulator) -> None:
        self._next = iter(self._actions)

    def act(self, p: Perception) -> int:
        return next(self._next, action_index(0, 0))


def _play(env: FlipperEnv, policy: Policy, seed: int) -> tuple[list[int], FloatArray, Row]:
    """Play an episode; return its actions, its poses at 100 Hz, (S, 5), and its result."""
    actions, poses, ending = [], [], None
    for decision in decisions(env, policy, seed):
        actions.append(int(decision.action))
        poses.append(decision.poses[1:])
        ending = decision.ending
    assert ending is not None  # decisions() yields until there is one
    return actions, np.concatenate(poses), ending


def _episode(
    index: int, rows: tuple[Row, Row], poses: tuple[FloatArray, FloatArray]
) -> EngineEpisode:
    first, second = rows
    both = min(map(len, poses))
    x, pitch = poses[0][:both, 0], poses[0][:both, 2]
    differences = np.abs(poses[1][:both, 2] - pitch)
    apart = np.flatnonzero(differences > PITCH_TOLERANCE)
    parts_at = None
    if apart.size:
        sample = int(apart[0])
        parts_at = round(0.01 * (sample + 1), 2), float(x[sample])
    return EngineEpisode(
        index,
        first["seed"],
        first["terrain"],
        (Outcome(first["outcome"]), Outcome(second["outcome"])),
        (first["t_cost"], second["t_cost"]),
        (first["pitch_variation_100hz"], second["pitch_variation_100hz"]),
        math.sqrt(float((differences**2).mean())),
        _pitch_rms_along(*poses),
        parts_at,
    )


def _pitch_rms_along(first: FloatArray, second: FloatArray) -> float:
    """Return the RMS difference of the pitches at equal x; both arrays are (S, 5) [rad]."""
    distances = [np.maximum.accumulate(poses[:, 0]) for poses in (first, second)]
    begin, end = max(d[0] for d in distances), min(d[-1] for d in distances)
    x = np.arange(begin, end, _ALONG)
    ours, theirs = (
        poses[np.searchsorted(d, x), 2] for d, poses in zip(distances, (first, second), strict=True)
    )
    return math.sqrt(float(((ours - theirs) ** 2).mean())) if len(x) else 0.0
