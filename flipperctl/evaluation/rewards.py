"""Judge a reward: the share of each term in the return, and whether it ranks policies by θ̂_R.

In: a policy, or the episodes of several with equal seeds, and sets of reward terms. Out: plain
documents with verdicts. A term that is too weak has no effect, one that saturates at most
steps tells nothing. A reward contradicts θ̂_R at 100 Hz if a policy has a higher return than another
but also a larger θ̂_R. Both paired differences must be beyond noise; ``decide`` corrects the tests
of all pairs of policies, rewards and scenes together. The episodes are played once for all rewards,
since the environment computes the terms of all of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from itertools import combinations, product
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, RewardTerm
from flipperctl.config import EvalConfig
from flipperctl.config.reward_sum import paying_terms
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.play import Player
from flipperctl.evaluation.regret import returns
from flipperctl.evaluation.rows import REWARD, Episodes
from flipperctl.evaluation.statistics import FEWEST, holm, interval, mean_p
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import EvaluationSeeds, decisions

Rewards = Mapping[str, RewardTerm]
"""Reward terms by name."""
_SIGNIFICANT = 0.05  # largest corrected p-value of a contradiction [-]
MEASURES = ("pitch_variation_100hz", "pitch_variation_decisions", "t_cost")
"""Measures by which policies are compared; the first one ranks them."""


def audit(
    config: EvalConfig,
    source: PolicySource,
    *,
    episodes: int,
    report: Callable[[float], None] = lambda done: None,
) -> dict[str, Any]:
    """Play the first episodes of an evaluation and summarise each reward term.

    ``report`` is called with the number of finished episodes; a controller's search before an
    episode counts as a fraction of it.
    """
    env = FlipperEnv(config=config)
    policy = source.build(config)
    seeds = EvaluationSeeds.of(config.eval.seed, config.terrain)
    collected: dict[str, list[float]] = {name: [] for name in config.rewards}
    # The values of all terms at every decision
    for index in range(episodes):

        def search(fraction: float, before: int = index) -> None:
            report(before + fraction)

        for decision in decisions(env, policy, seeds(index), report_progress=search):
            for name, value in decision.rewards.items():
                collected[name].append(value)
        report(index + 1.0)
    # Shares are of the absolute sum, since terms of opposite signs would cancel.
    values = {name: np.array(column) for name, column in collected.items()}  # each (D,)
    total = sum(float(np.abs(column).sum()) for column in values.values())
    return {
        "controller": source.label(),
        "terrain": config.terrain.title,
        "episodes": episodes,
        "decisions": len(next(iter(values.values()), np.empty(0))),
        "return": sum(float(column.sum()) for column in values.values()) / episodes,
        "terms": {name: _term(config.rewards[name], v, total) for name, v in values.items()},
        "seed": config.eval.seed,
        "conditions": Conditions.of(config).to_dict(),
    }


def _term(term: RewardTerm, values: FloatArray, total: float) -> dict[str, Any]:
    """Summarise the (D,) weighted values of a term; ``total`` is the absolute sum of all terms.

    ``share``: fraction of that sum; ``saturated``: fraction of decisions at the declared lower
    bound, None without one or at a weight of 0.
    """
    floor, sign = term.bounds[0] * term.weight, np.sign(term.weight)
    floored = math.isfinite(floor) and sign != 0
    return {
        "weight": term.weight,
        "mean": float(values.mean()),
        "lowest": float(values.min()),
        "highest": float(values.max()),
        "share": float(np.abs(values).sum()) / total if total else 0.0,
        "saturated": float((sign * values <= sign * floor).mean()) if floored else None,
    }


class Verdict(StrEnum):
    """Whether a reward's ranking agrees with the one by θ̂_R."""

    AGREES = "agrees"
    """No contradiction was found; a small one may need more episodes."""
    CONTRADICTS = "contradicts"
    UNDECIDED = "undecided"
    """Every policy crossed fewer than ``FEWEST`` common seeds, or ``decide`` was not called."""


RewardScene = tuple[EvalConfig, Mapping[str, Rewards]]
"""A scene, whose ``eval`` has the number of episodes and the seed, and sets of rewards by label."""


def rank_policies(
    scenes: Sequence[RewardScene], policies: Mapping[str, PolicySource], player: Player
) -> list[dict[str, Any]]:
    """Rank the policies on every scene, and find the contradictions among all of them.

    ``policies``: their sources by the labels that the result uses.
    """
    for (config, rewards), (label, source) in product(scenes, policies.items()):
        source.build(config)  # raises for a wrong layout or robot
        if len(rewards) > 1 and source.plans_for_rewards:
            raise ConfigError(
                f"{label} drives otherwise for each of the rewards "
                f"{', '.join(rewards)}; one of them is allowed"
            )
    return decide([_scene(*scene, policies, player) for scene in scenes])


def _scene(
    config: EvalConfig,
    rewards: Mapping[str, Rewards],
    policies: Mapping[str, PolicySource],
    player: Player,
) -> dict[str, Any]:
    terrain = config.terrain.title
    # Terms of all rewards at once, so that the episodes are played once
    terms_of_all = {f"{at}.{n}": term for at, terms in rewards.items() for n, term in terms.items()}
    whole = config.model_copy(update={"rewards": terms_of_all})
    played = {
        label: player.play(whole, source, f"{terrain}, {label}")
        for label, source in policies.items()
    }
    measured = measures(played)
    return {
        "terrain": terrain,
        "seed": config.eval.seed,
        "conditions": Conditions.of(config).to_dict(),
        "episodes": config.eval.episodes,
        "common": len(next(iter(common_episodes(played).values()))),
        "by_pitch_variation_100hz": list(measured),
        "policies": measured,
        "rankings": [rank(at, terms, played, f"{at}.") for at, terms in rewards.items()],
    }


def common_episodes(played: Mapping[str, Episodes]) -> dict[str, Episodes]:
    """Return each policy's episodes with the seeds that every policy crossed."""
    crossed = [{row["seed"] for row in episodes.reached} for episodes in played.values()]
    seeds = set.intersection(*crossed)
    return {
        label: episodes.where(lambda row: row["seed"] in seeds)
        for label, episodes in played.items()
    }


def measures(played: Mapping[str, Episodes]) -> dict[str, dict[str, Any]]:
    """Return success and measures of each policy, smallest θ̂_R at 100 Hz first.

    Measures are means over the seeds that every policy crossed; None if there are none.
    """
    common = common_episodes(played)
    by_label: dict[str, dict[str, Any]] = {
        label: {
            "success_rate": len(episodes.reached) / len(episodes),
            **{name: _mean(common[label].values(name)) for name in MEASURES},
        }
        for label, episodes in played.items()
    }
    means = {
        label: (numbers[MEASURES[0]] or {"mean": 0.0})["mean"]
        for label, numbers in by_label.items()
    }
    return {label: by_label[label] for label in sorted(by_label, key=means.__getitem__)}


def rank(
    label: str, terms: Rewards, played: Mapping[str, Episodes], prefix: str = ""
) -> dict[str, Any]:
    """Rank the policies by their return from ``terms`` and compare with θ̂_R at 100 Hz.

    The contradictions are candidates until ``decide`` has corrected their p-values; ``tests`` is
    the number of pairs. ``prefix`` precedes the terms' names in the columns of the rewards.
    """
    common = common_episodes(played)
    names = paying_terms(terms)
    paid = {name: returns(episodes, names, prefix).tolist() for name, episodes in common.items()}
    means = {name: _mean(values) for name, values in paid.items()}
    ordered = dict(sorted(means.items(), key=lambda item: -item[1]["mean"] if item[1] else 0.0))
    # A few common episodes decide nothing.
    enough = len(next(iter(common.values()))) >= FEWEST
    pairs = list(combinations(common, 2)) if enough else []
    tested = (_contradiction(pair, common, paid, names, prefix) for pair in pairs)
    candidates = sorted(
        (contradiction for contradiction in tested if contradiction is not None),
        key=lambda contradiction: -contradiction["pitch_variation_100hz_difference"]["mean"],
    )
    return {
        "rewards": label,
        "verdict": str(Verdict.UNDECIDED),
        "by_return": list(ordered),
        "returns": ordered,
        "contradictions": candidates,
        "tests": len(pairs),
    }


def decide(scenes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rankings with verdicts, without contradictions that may be noise.

    The p-values are corrected for all tests of all scenes together. A pair whose differences have
    opposite signs has a p-value of 1.
    """
    # Tests without a contradiction count for the correction, too.
    rankings = [ranking for scene in scenes for ranking in scene["rankings"]]
    contradictions = [
        contradiction for ranking in rankings for contradiction in ranking["contradictions"]
    ]
    tests = sum(ranking["tests"] for ranking in rankings)
    corrected = holm(
        [
            *(contradiction["p"] for contradiction in contradictions),
            *[1.0] * (tests - len(contradictions)),
        ]
    )
    for contradiction, p in zip(contradictions, corrected, strict=False):
        contradiction |= {"p_holm": p, "holm_of": tests}
    # Only a contradiction beyond chance remains.
    for ranking in rankings:
        significant = [
            contradiction
            for contradiction in ranking["contradictions"]
            if contradiction["p_holm"] <= _SIGNIFICANT
        ]
        ranking["contradictions"] = significant
        if ranking.pop("tests"):
            ranking["verdict"] = str(Verdict.CONTRADICTS if significant else Verdict.AGREES)
    return scenes


def _contradiction(
    pair: tuple[str, str],
    common: Mapping[str, Episodes],
    paid: Mapping[str, Sequence[float]],
    names: Sequence[str],
    prefix: str,
) -> dict[str, Any] | None:
    """Return the contradiction if one policy has the larger mean return and the larger θ̂_R.

    ``p`` is the larger one of the paired t-tests, since both differences must be significant.
    """

    def differences(values: Mapping[str, Sequence[float]]) -> list[float]:
        return [a - b for a, b in zip(*(values[label] for label in pair), strict=True)]

    # The rougher policy comes first.
    measured = {label: common[label].values(MEASURES[0]) for label in pair}
    if sum(differences(measured)) < 0:
        pair = pair[::-1]
    variation, gain = differences(measured), differences(paid)
    if not (sum(variation) > 0 and sum(gain) > 0):
        return None
    # Which terms pay for the rougher drive
    parts = {}
    for name in names:
        column = f"{REWARD}{prefix}{name}"
        values = differences({label: [row[column] for row in common[label]] for label in pair})
        parts[name] = sum(values) / len(values)
    p = max(mean_p(variation), mean_p(gain))
    return {
        "paid": pair[0],
        "calm": pair[1],
        "return_difference": interval(gain).to_dict(),
        "pitch_variation_100hz_difference": interval(variation).to_dict(),
        "terms": dict(sorted(parts.items(), key=lambda item: -item[1])),
        "p": p,
        "p_holm": p,
    }


def _mean(values: Sequence[float]) -> dict[str, Any] | None:
    """Return the mean of (K,) values with its interval; None without values."""
    return interval(values).to_dict() if values else None
