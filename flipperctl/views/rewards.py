"""Judge a reward: the share of each term in the return, and whether it ranks policies by θ̂_R.

In: a policy, or the episodes of several with equal seeds, and sets of reward terms. Out: a
document, a table and verdicts. A term that is too weak has no effect, one that saturates at most
steps tells nothing. A reward contradicts θ̂_R at 100 Hz if a policy has a higher return than another
but also a larger θ̂_R. Both paired differences must be beyond noise; ``decide`` corrects the tests
of all pairs of policies, rewards and scenes together. The episodes are played once for all rewards,
since the environment computes the terms of all of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
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
from flipperctl.text.show import Column, Table, interval_text
from flipperctl.views.summary import VARIATION, Document, named, short

Rewards = Mapping[str, RewardTerm]
"""Reward terms by name."""
_SIGNIFICANT = 0.05  # largest corrected p-value of a contradiction [-]
_TERMS = (
    Column("term", "term", named=True),
    Column("weight", "weight"),
    Column("mean", "mean of a decision", 4),
    Column("lowest", "lowest", 3),
    Column("highest", "highest", 3),
    Column("share_text", "share of the return"),
    Column("saturated_text", "saturated"),
)
_MEASURES = ("pitch_variation_100hz", "pitch_variation", "t_cost")


def audit(
    config: EvalConfig,
    source: PolicySource,
    *,
    episodes: int,
    report: Callable[[float], None] = lambda done: None,
) -> Document:
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
        "terrain": config.terrain.plugin_name,
        "episodes": episodes,
        "decisions": len(next(iter(values.values()), np.empty(0))),
        "return": sum(float(column.sum()) for column in values.values()) / episodes,
        "terms": {name: _term(config.rewards[name], v, total) for name, v in values.items()},
        "seed": config.eval.seed,
        "conditions": Conditions.of(config).to_dict(),
    }


def _term(term: RewardTerm, values: FloatArray, total: float) -> Document:
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


def audit_table(audited: Document, notes: Sequence[str]) -> Table:
    """Return a row for each term, with lines below the table."""
    rows = [
        {
            "term": name,
            **term,
            "share_text": f"{term['share']:.1%}",
            "saturated_text": "–" if term["saturated"] is None else f"{term['saturated']:.1%}",
        }
        for name, term in audited["terms"].items()
    ]
    title = (
        f"{audited['controller']} on {audited['terrain']} · {audited['episodes']} episodes, "
        f"{audited['decisions']} decisions · mean return {audited['return']:.2f}"
    )
    return Table(_TERMS, rows, title, list(notes))


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
) -> list[Document]:
    """Rank the policies on every scene, and find the contradictions among all of them.

    ``policies``: their sources by the labels that the result uses.
    """
    for (config, rewards), (label, source) in product(scenes, policies.items()):
        source.build(config)  # raises for a wrong layout or robot
        if len(rewards) > 1 and source.plans_for_rewards:
            raise ConfigError(
                f"--compare: {label} drives otherwise for each of the rewards "
                f"{', '.join(rewards)}; one of them is allowed"
            )
    return decide([_scene(*scene, policies, player) for scene in scenes])


def _scene(
    config: EvalConfig,
    rewards: Mapping[str, Rewards],
    policies: Mapping[str, PolicySource],
    player: Player,
) -> Document:
    terrain = config.terrain.plugin_name
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


def measures(played: Mapping[str, Episodes]) -> dict[str, Document]:
    """Return success and measures of each policy, smallest θ̂_R at 100 Hz first.

    Measures are means over the seeds that every policy crossed; None if there are none.
    """
    common = common_episodes(played)
    by_label: dict[str, Document] = {
        label: {
            "success_rate": len(episodes.reached) / len(episodes),
            **{name: _mean(common[label].values(name)) for name in _MEASURES},
        }
        for label, episodes in played.items()
    }
    means = {
        label: (numbers[_MEASURES[0]] or {"mean": 0.0})["mean"]
        for label, numbers in by_label.items()
    }
    return {label: by_label[label] for label in sorted(by_label, key=means.__getitem__)}


def rank(label: str, terms: Rewards, played: Mapping[str, Episodes], prefix: str = "") -> Document:
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


def decide(scenes: list[Document]) -> list[Document]:
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
        contradiction["p_holm"] = p
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
) -> Document | None:
    """Return the contradiction if one policy has the larger mean return and the larger θ̂_R.

    ``p`` is the larger one of the paired t-tests, since both differences must be significant.
    """

    def differences(values: Mapping[str, Sequence[float]]) -> list[float]:
        return [a - b for a, b in zip(*(values[label] for label in pair), strict=True)]

    # The rougher policy comes first.
    measured = {label: common[label].values(_MEASURES[0]) for label in pair}
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


def _mean(values: Sequence[float]) -> Document | None:
    """Return the mean of (K,) values with its interval; None without values."""
    return interval(values).to_dict() if values else None


def table(scenes: Sequence[Document]) -> Table:
    """Return a table with a row for each policy on each scene, smallest θ̂_R first."""
    labels = dict.fromkeys(ranking["rewards"] for s in scenes for ranking in s["rankings"])
    rows: list[dict[str, Any]] = []
    for name, scene in named({"scenes": scenes}):
        paid = {f"return_{ranking['rewards']}": ranking["returns"] for ranking in scene["rankings"]}
        for at, (label, policy) in enumerate(scene["policies"].items()):
            numbers = {key: policy[key] for key in _MEASURES}
            numbers |= {key: returns[label] for key, returns in paid.items()}
            rows.append(
                {
                    "scene": f"{name} ({scene['common']} of {scene['episodes']})" if not at else "",
                    "line": not at,
                    "policy": short(label),
                    "success": f"{100 * policy['success_rate']:.3g} %",
                    **{key: interval and interval["mean"] for key, interval in numbers.items()},
                }
            )
    columns = (
        Column("scene", "scene (crossed by all)", named=True),
        Column("policy", "policy", named=True),
        Column("success", "success"),
        Column("pitch_variation_100hz", VARIATION),
        Column("t_cost", "time [s]", 1),
        *(Column(f"return_{label}", f"reward, {label}") for label in labels),
    )
    return Table(columns, rows, "Means over the episodes that every policy crossed")


def verdict_lines(scenes: Sequence[Document]) -> Iterator[str]:
    """Yield a line for each contradiction, and then the verdict on each set of reward terms."""
    words = {
        Verdict.CONTRADICTS: "CONTRADICTS pitch variation on",
        Verdict.AGREES: "no contradiction to pitch variation on",
        Verdict.UNDECIDED: f"undecided (fewer than {FEWEST} common episodes) on",
    }
    # Contradictions one by one, then a verdict on each set of terms
    verdicts: dict[str, dict[str, list[str]]] = {}
    for name, scene in named({"scenes": scenes}):
        for ranking in scene["rankings"]:
            known = verdicts.setdefault(ranking["rewards"], {})
            known.setdefault(ranking["verdict"], []).append(name)
            for rival in ranking["contradictions"]:
                term, part = next(iter(rival["terms"].items()))
                gain = interval_text(rival["return_difference"])
                variation = interval_text(rival["pitch_variation_100hz_difference"])
                yield (
                    f"{ranking['rewards']} on {name}: the reward of {rival['paid']} is {gain} "
                    f"larger than that of {rival['calm']}, but its pitch variation is {variation} "
                    f"rad larger (p {rival['p_holm']:.2g}); the term {term} contributes {part:+.2f}"
                )
    for label, by_verdict in verdicts.items():
        parts = [f"{words[v]} {', '.join(on)}" for v in words if (on := by_verdict.get(v))]
        yield f"{label}: {'; '.join(parts)}"
