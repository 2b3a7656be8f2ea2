"""The regret of a policy: how much more than its own return is known to be possible.

In: the episodes of a policy and of references with equal seeds, and their configuration. Out: a
``SceneRegret``. All episodes count, also those that did not reach the finish, since their returns
include what the reward charges for that. Potential-based shaping is left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from flipperctl.config import EvalConfig
from flipperctl.core.arrays import FloatArray
from flipperctl.evaluation import plain
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.estimates import Interval
from flipperctl.evaluation.intervals import interval
from flipperctl.evaluation.returns import paying_terms

LEVEL = "level"
"""The controller that holds the flippers still."""
_ROUNDING = 1e-9
"""Gain over ``LEVEL`` that rounding alone explains [-]."""


class Verdict(StrEnum):
    """How a policy's return compares with that of holding the flippers still, paired by seed."""

    LESS = "less"
    """The 95 % interval of the difference lies below 0."""
    MORE = "more"
    """The 95 % interval of the difference lies above 0."""
    UNDECIDED = "undecided"
    """The interval contains 0, or there are too few episodes for one."""


@dataclass(frozen=True)
class PolicyReturn:
    """The returns of one policy; differences are paired by seed, and intervals are of 95 %."""

    success_rate: float
    """Fraction of the episodes in which it reached the finish, 0 to 1."""
    pitch_variation_100hz: float | None
    """Mean θ̂_R of these episodes [rad]; None without one."""
    pitch_above_level: Interval | None
    """Its θ̂_R minus that of ``LEVEL`` where both reached the finish [rad]; None without such."""
    mean: Interval
    """Return without shaping [-]."""
    regret: Interval
    """The best known return of each episode minus its own [-]."""
    above_level: Interval
    """Its return minus that of ``LEVEL`` [-]."""
    fraction: float | None
    """The part of the best known gain over ``LEVEL`` that it earns; None without such a gain."""
    returns: tuple[float, ...]
    """Return of each episode [-]."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "success_rate": self.success_rate,
            "pitch_variation_100hz": self.pitch_variation_100hz,
            "pitch_above_level": plain.data(self.pitch_above_level),
            "return": self.mean.to_dict(),
            "regret": self.regret.to_dict(),
            "above_level": self.above_level.to_dict(),
            "fraction": self.fraction,
            "returns": list(self.returns),
        }


@dataclass(frozen=True)
class BestReference:
    """The reference with the highest mean return."""

    name: str
    regret: Interval
    """Its return minus that of the policy, paired by seed [-]."""
    fraction: float | None
    """The part of its gain over ``LEVEL`` that the policy earns; None without such a gain."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {"name": self.name, "regret": self.regret.to_dict(), "fraction": self.fraction}


@dataclass(frozen=True)
class SceneRegret:
    """The returns of a policy and of references on the same episodes of one terrain."""

    terrain: str
    rewards: str
    """Label of the reward terms."""
    seed: int
    """Seed of the evaluation."""
    conditions: Conditions
    episodes: int
    name: str
    """Name of the policy."""
    policy: PolicyReturn
    references: Mapping[str, PolicyReturn]
    """By name, highest mean return first."""
    best_known: Interval
    """Highest return of each episode over the policy and all references [-]."""
    best_reference: BestReference

    @property
    def verdict(self) -> Verdict:
        """Whether the policy earns more or less than holding the flippers still."""
        found = self.policy.above_level
        if found.high is not None and found.high < 0:
            return Verdict.LESS
        return Verdict.MORE if found.low is not None and found.low > 0 else Verdict.UNDECIDED

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "terrain": self.terrain,
            "rewards": self.rewards,
            "seed": self.seed,
            "conditions": self.conditions.to_dict(),
            **self.result(),
        }

    def result(self) -> dict[str, Any]:
        """Return what was measured as plain data, without the conditions."""
        return {
            "episodes": self.episodes,
            "verdict": str(self.verdict),
            "name": self.name,
            "policy": self.policy.to_dict(),
            "references": {name: found.to_dict() for name, found in self.references.items()},
            "best_known": {"return": self.best_known.to_dict()},
            "best_reference": self.best_reference.to_dict(),
        }


@dataclass(frozen=True)
class Played:
    """The episodes of a policy and of its references, with equal seeds in the same order."""

    name: str
    """Name of the policy."""
    policy: Sequence[EpisodeResult]
    references: Mapping[str, Sequence[EpisodeResult]]
    """By name; ``LEVEL`` is one of them."""


def regret(config: EvalConfig, label: str, played: Played) -> SceneRegret:
    """Compare the returns of a policy with those of its references.

    ``config`` is that of the episodes; its reward terms make the return, and ``label`` names them.
    """
    names = paying_terms(config.rewards)

    def returns(episodes: Sequence[EpisodeResult]) -> FloatArray:
        return np.array([sum(e.rewards[name] for name in names) for e in episodes])

    own = returns(played.policy)  # (K,) [-]
    others = {name: returns(episodes) for name, episodes in played.references.items()}
    best = np.max([own, *others.values()], axis=0)  # (K,) [-]
    level, still = others[LEVEL], played.references[LEVEL]

    def measured(values: FloatArray, episodes: Sequence[EpisodeResult]) -> PolicyReturn:
        pitches = [e.pitch_variation_100hz for e in episodes if e.reached]
        both = [(a, b) for a, b in zip(episodes, still, strict=True) if a.reached and b.reached]
        above = [a.pitch_variation_100hz - b.pitch_variation_100hz for a, b in both]
        return PolicyReturn(
            success_rate=sum(e.reached for e in episodes) / len(episodes),
            pitch_variation_100hz=float(np.mean(pitches)) if pitches else None,
            pitch_above_level=interval(above) if above else None,
            mean=_interval(values),
            regret=_interval(best - values),
            above_level=_interval(values - level),
            fraction=_fraction(values, best, level),
            returns=tuple(values.tolist()),
        )

    ordered = sorted(others, key=lambda name: -float(others[name].mean()))
    top = ordered[0]
    return SceneRegret(
        terrain=config.terrain.plugin_name,
        rewards=label,
        seed=config.eval.seed,
        conditions=Conditions.of(config),
        episodes=len(own),
        name=played.name,
        policy=measured(own, played.policy),
        references={name: measured(others[name], played.references[name]) for name in ordered},
        best_known=_interval(best),
        best_reference=BestReference(
            top, _interval(others[top] - own), _fraction(own, others[top], level)
        ),
    )


def _interval(values: FloatArray) -> Interval:
    return interval(values.tolist())


def _fraction(values: FloatArray, best: FloatArray, level: FloatArray) -> float | None:
    """Return the part of the mean gain of ``best`` over ``level`` that ``values`` have.

    None if the gain is not positive, or no larger than noise: its 95 % interval contains 0. Divided
    by such a gain, one lucky episode of a reference would make any number.
    """
    gain = _interval(best - level)
    if gain.mean <= _ROUNDING or (gain.low is not None and gain.low <= 0):
        return None
    return float((values - level).mean()) / gain.mean
