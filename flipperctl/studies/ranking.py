"""Rank policies by return and by θ̂_R at 100 Hz on the same episodes, and find contradictions.

In: the episodes that each policy played with equal seeds, and one or several sets of reward terms.
Out: a ``SceneRanking``. A reward contradicts the measure if a policy has a higher return than
another but also a larger θ̂_R, with both paired differences beyond noise; ``decide`` corrects the
tests of all pairs of policies, rewards and scenes together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import combinations
from typing import Any

from flipperctl.api import RewardTerm
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.estimates import Interval
from flipperctl.evaluation.intervals import FEWEST, holm, interval, mean_p
from flipperctl.evaluation.returns import paying_terms

_SIGNIFICANT = 0.05
"""Largest corrected p-value of a contradiction [-]."""

Played = Mapping[str, Sequence[EpisodeResult]]
"""The episodes of each policy by its label, all with the same seeds in the same order."""


class Verdict(StrEnum):
    """Whether a reward's ranking agrees with the one by θ̂_R."""

    AGREES = "agrees"
    """No contradiction was found; a small one may need more episodes."""
    CONTRADICTS = "contradicts"
    UNDECIDED = "undecided"
    """Every policy crossed fewer than ``FEWEST`` common seeds, or ``decide`` was not called."""


@dataclass(frozen=True)
class PolicyMeasures:
    """A policy's measures over the seeds that every policy crossed; None if there are none."""

    success_rate: float
    """Fraction of all episodes in which the policy reached the finish, 0 to 1."""
    pitch_variation_100hz: Interval | None
    """θ̂_R at 100 Hz [rad]."""
    pitch_variation: Interval | None
    """θ̂_R at decisions [rad]."""
    t_cost: Interval | None
    """Time from start to finish [s]."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "success_rate": self.success_rate,
            "pitch_variation_100hz": _data(self.pitch_variation_100hz),
            "pitch_variation": _data(self.pitch_variation),
            "t_cost": _data(self.t_cost),
        }


@dataclass(frozen=True)
class Contradiction:
    """A policy whose return and θ̂_R both exceed those of another."""

    paid: str
    """Label of the policy with the higher return."""
    calm: str
    """Label of the policy with the smaller θ̂_R."""
    return_difference: Interval
    """Return of ``paid`` minus that of ``calm``, paired by seed [-]."""
    pitch_variation_100hz_difference: Interval
    """θ̂_R at 100 Hz of ``paid`` minus that of ``calm``, paired by seed [rad]."""
    terms: Mapping[str, float]
    """Contribution of each term to the mean difference of returns, largest first [-]."""
    p: float
    """The larger p-value of the paired t-tests of both differences [-]."""
    p_holm: float
    """The same, corrected for all pairs of policies, rewards and scenes (Holm) [-]."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "paid": self.paid,
            "calm": self.calm,
            "return_difference": self.return_difference.to_dict(),
            "pitch_variation_100hz_difference": self.pitch_variation_100hz_difference.to_dict(),
            "terms": dict(self.terms),
            "p": self.p,
            "p_holm": self.p_holm,
        }


@dataclass(frozen=True)
class RewardRanking:
    """The ranking of the policies by one set of reward terms, on one scene."""

    rewards: str
    """Label of the set: the preset with its changes."""
    verdict: Verdict
    returns: Mapping[str, Interval | None]
    """Return by policy, highest first, without potential-based shaping; None without seeds [-]."""
    contradictions: tuple[Contradiction, ...]
    """Largest difference of θ̂_R first."""
    tests: int
    """Number of pairs of policies that were tested."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "rewards": self.rewards,
            "verdict": str(self.verdict),
            "by_return": list(self.returns),
            "returns": {label: _data(found) for label, found in self.returns.items()},
            "contradictions": [c.to_dict() for c in self.contradictions],
        }


@dataclass(frozen=True)
class SceneRanking:
    """Policies on the same episodes of one terrain, ranked by each set of reward terms."""

    terrain: str
    seed: int
    """Seed of the evaluation."""
    conditions: Conditions
    episodes: int
    """Number of episodes that each policy played."""
    common: int
    """Number of seeds that every policy crossed; measures are taken over these."""
    policies: Mapping[str, PolicyMeasures]
    """Measures by policy, smallest θ̂_R at 100 Hz first."""
    rankings: tuple[RewardRanking, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "terrain": self.terrain,
            "seed": self.seed,
            "conditions": self.conditions.to_dict(),
            "episodes": self.episodes,
            "common": self.common,
            "by_pitch_variation_100hz": list(self.policies),
            "policies": {label: found.to_dict() for label, found in self.policies.items()},
            "rankings": [ranking.to_dict() for ranking in self.rankings],
        }


def common_episodes(played: Played) -> dict[str, list[EpisodeResult]]:
    """Return each policy's episodes with the seeds that every policy crossed."""
    crossed = [{e.seed for e in episodes if e.reached} for episodes in played.values()]
    seeds = set.intersection(*crossed)
    return {label: [e for e in own if e.seed in seeds] for label, own in played.items()}


def measures(played: Played) -> dict[str, PolicyMeasures]:
    """Return the measures of each policy, smallest θ̂_R at 100 Hz first."""
    common = common_episodes(played)
    found = {
        label: PolicyMeasures(
            success_rate=sum(e.reached for e in episodes) / len(episodes),
            pitch_variation_100hz=_mean(common[label], _pitch_variation),
            pitch_variation=_mean(common[label], lambda e: e.pitch_variation),
            t_cost=_mean(common[label], lambda e: e.t_cost),
        )
        for label, episodes in played.items()
    }

    def pitch_variation(label: str) -> float:
        known = found[label].pitch_variation_100hz
        return known.mean if known else 0.0

    return {label: found[label] for label in sorted(found, key=pitch_variation)}


def rank(
    label: str, terms: Mapping[str, RewardTerm], played: Played, prefix: str = ""
) -> RewardRanking:
    """Rank the policies by their return from ``terms`` and compare with θ̂_R at 100 Hz.

    The contradictions are candidates until ``decide`` has corrected their p-values.
    ``prefix`` precedes the terms' names in the episodes' rewards. Potential-based shaping is
    left out (``returns.paying_terms``).
    """
    common = common_episodes(played)
    names = paying_terms(terms)

    def paid(episode: EpisodeResult) -> float:
        return sum(episode.rewards[prefix + name] for name in names)

    returns = {label: _mean(episodes, paid) for label, episodes in common.items()}
    ordered = sorted(returns.items(), key=lambda item: -item[1].mean if item[1] else 0.0)
    common_seeds = len(next(iter(common.values())))
    if common_seeds < FEWEST:
        return RewardRanking(label, Verdict.UNDECIDED, dict(ordered), (), 0)
    pairs = list(combinations(common, 2))
    tested = (_contradiction(pair, common, paid, names, prefix) for pair in pairs)
    found = sorted(
        (one for one in tested if one is not None),
        key=lambda one: -one.pitch_variation_100hz_difference.mean,
    )
    return RewardRanking(label, Verdict.UNDECIDED, dict(ordered), tuple(found), len(pairs))


def decide(scenes: Sequence[SceneRanking]) -> list[SceneRanking]:
    """Return the rankings with verdicts, without contradictions that may be noise.

    The p-values are corrected for all tests of all scenes together. A pair whose differences have
    opposite signs has a p-value of 1.
    """
    rankings = [ranking for scene in scenes for ranking in scene.rankings]
    found = [one.p for ranking in rankings for one in ranking.contradictions]
    others = sum(ranking.tests for ranking in rankings) - len(found)
    corrected = iter(holm([*found, *[1.0] * others]))
    decided = iter([_decided(ranking, corrected) for ranking in rankings])
    return [replace(s, rankings=tuple(next(decided) for _ in s.rankings)) for s in scenes]


def _decided(ranking: RewardRanking, corrected: Iterator[float]) -> RewardRanking:
    every = [replace(one, p_holm=next(corrected)) for one in ranking.contradictions]
    kept = tuple(one for one in every if one.p_holm <= _SIGNIFICANT)
    verdict = Verdict.UNDECIDED
    if ranking.tests:
        verdict = Verdict.CONTRADICTS if kept else Verdict.AGREES
    return replace(ranking, verdict=verdict, contradictions=kept)


def _contradiction(
    pair: tuple[str, str],
    common: Played,
    paid: Callable[[EpisodeResult], float],
    names: Sequence[str],
    prefix: str,
) -> Contradiction | None:
    """Return the contradiction if one policy has the larger mean return and the larger θ̂_R."""

    def differences(value: Callable[[EpisodeResult], float]) -> list[float]:
        return [value(one) - value(other) for one, other in paired]

    paired = list(zip(*(common[label] for label in pair), strict=True))
    if sum(differences(_pitch_variation)) < 0:
        pair, paired = pair[::-1], [(other, one) for one, other in paired]
    variation, gain = differences(_pitch_variation), differences(paid)
    if not (sum(variation) > 0 and sum(gain) > 0):
        return None
    parts = {
        name: sum(a.rewards[prefix + name] - b.rewards[prefix + name] for a, b in paired)
        / len(paired)
        for name in names
    }
    terms = dict(sorted(parts.items(), key=lambda item: -item[1]))
    # Both differences must be significant, so the larger p-value counts.
    p = max(mean_p(variation), mean_p(gain))
    return Contradiction(*pair, interval(gain), interval(variation), terms, p, p)


def _pitch_variation(episode: EpisodeResult) -> float:
    return episode.pitch_variation_100hz


def _mean(
    episodes: Sequence[EpisodeResult], value: Callable[[EpisodeResult], float]
) -> Interval | None:
    return interval([value(e) for e in episodes]) if episodes else None


def _data(found: Interval | None) -> dict[str, float] | None:
    return None if found is None else found.to_dict()
