"""Rewards: contradictions to θ̂_R on episodes made by hand, and the shares of their terms."""

from typing import Any

import pytest

from flipperctl.api import RewardTerm
from flipperctl.config import EvalConfig, resolver
from flipperctl.evaluation.play import EpisodeRunner
from flipperctl.evaluation.rewards import Verdict, audit, decide, measures, rank
from flipperctl.evaluation.rows import Episodes
from flipperctl.policies.source import PolicySource
from tests.evaluation.samples import episodes as rows
from tests.evaluation.samples import sample

TERMS: dict[str, RewardTerm] = {
    "swing": resolver.create("reward", "swing", "rewards.swing"),
    "travel": resolver.create("reward", "travel", "rewards.travel"),
    "shaped": resolver.create("reward", "shaped_progress", "rewards.shaped"),
}


def episodes(
    values: list[float], price: float, travel: float | list[float], **more: Any
) -> Episodes:
    """Episodes whose θ̂_R at 100 Hz is twice ``values`` [rad], which cost ``price`` per radian."""
    outcomes = more.pop("outcomes", ["reached"] * len(values))
    travels = travel if isinstance(travel, list) else [travel] * len(values)
    return rows(
        [
            sample(
                seed,
                outcome,
                value,
                reward_swing=-price * 2 * value,
                reward_travel=travels[seed],
                reward_shaped=5.0 * value,
            )
            for seed, (outcome, value) in enumerate(zip(outcomes, values, strict=True))
        ]
    )


def on_scene(*rankings: dict[str, Any]) -> dict[str, Any]:
    return {"rankings": list(rankings)}


def ranked(
    label: str, terms: dict[str, RewardTerm], played: dict[str, Episodes], prefix: str = ""
) -> dict[str, Any]:
    """Return the ranking as it is decided without further comparisons."""
    undecided = rank(label, terms, played, prefix)
    assert undecided["verdict"] == Verdict.UNDECIDED
    (scene,) = decide([on_scene(undecided)])
    found: dict[str, Any] = scene["rankings"][0]
    return found


ROUGH, CALM = [1.0, 1.1, 0.9, 1.0, 1.2], [0.5, 0.6, 0.4, 0.5, 0.7]


def test_a_reward_that_prices_the_smooth_way_out_is_flagged() -> None:
    # The calm policy saves 1 rad at 100 Hz, worth 8, and turns its flippers for 8.6.
    played = {"level": episodes(ROUGH, 8, 0.0), "planner": episodes(CALM, 8, -8.6)}
    found = ranked("smooth", TERMS, played)
    assert found["verdict"] == Verdict.CONTRADICTS
    (contradiction,) = found["contradictions"]
    assert (contradiction["paid"], contradiction["calm"]) == ("level", "planner")
    assert contradiction["return_difference"]["mean"] == pytest.approx(0.6)
    gap = contradiction["pitch_variation_100hz_difference"]
    assert gap["mean"] == pytest.approx(1.0)
    assert list(contradiction["terms"]) == ["travel", "swing"]
    assert contradiction["terms"] == {"travel": pytest.approx(8.6), "swing": pytest.approx(-8.0)}
    assert list(found["returns"]) == ["level", "planner"]
    assert list(measures(played)) == ["planner", "level"]


def test_a_reward_that_pays_the_calm_policy_agrees_and_noise_contradicts_nothing() -> None:
    level = episodes(ROUGH, 8, 0.0)
    found = ranked("swing", TERMS, {"level": level, "planner": episodes(CALM, 8, -7.0)})
    assert (found["verdict"], found["contradictions"]) == (Verdict.AGREES, [])
    assert list(found["returns"]) == ["planner", "level"]
    # The return differs by 0.6 at every draw, θ̂_R by -0.4 to 0.6 rad.
    mixed = episodes([1.2, 0.9, 0.7, 1.2, 1.3], 0, 0.0)
    played = {"level": episodes(ROUGH, 0, 0.6), "planner": mixed}
    assert ranked("flat", TERMS, played)["verdict"] == Verdict.AGREES
    noisy = episodes(CALM, 8, [-20.0, 2.0, -20.0, 2.0, -8.0])  # on average as above
    assert ranked("noisy", TERMS, {"level": level, "planner": noisy})["verdict"] == Verdict.AGREES


def test_only_draws_that_every_policy_crossed_count() -> None:
    fails = ["reached", "stuck", "reached", "reached", "reached"]
    played = {
        "level": episodes([*ROUGH[:1], 9.0, *ROUGH[2:]], 8, 0.0, outcomes=fails),
        "planner": episodes(CALM, 8, -8.6),
    }
    found = measures(played)
    assert (found["level"]["success_rate"], found["planner"]["success_rate"]) == (0.8, 1.0)
    swing = found["level"]["pitch_variation_100hz"]
    assert swing["mean"] == pytest.approx(2 * (1.0 + 0.9 + 1.0 + 1.2) / 4)
    # Four draws are too few for a verdict.
    assert ranked("smooth", TERMS, played)["verdict"] == Verdict.UNDECIDED


def test_no_common_draw_gives_no_measures() -> None:
    played = {
        "level": episodes([1.0], 8, 0.0, outcomes=["stuck"]),
        "planner": episodes([1.0], 8, 0.0),
    }
    assert measures(played)["planner"] == {
        "success_rate": 1.0,
        "pitch_variation_100hz": None,
        "pitch_variation_decisions": None,
        "t_cost": None,
    }
    found = ranked("smooth", TERMS, played)
    assert (found["verdict"], found["returns"]) == (
        Verdict.UNDECIDED,
        {"level": None, "planner": None},
    )


def test_the_terms_of_several_rewards_are_told_apart_by_their_prefix() -> None:
    played = {
        label: rows(
            [
                sample(i, "reached", v, **{"reward_a.swing": paid, "reward_b.swing": -paid})
                for i, v in enumerate(values)
            ]
        )
        for label, values, paid in (("level", ROUGH, 1.0), ("planner", CALM, 2.0))
    }
    terms = {"swing": TERMS["swing"]}
    assert ranked("a", terms, played, "a.")["verdict"] == Verdict.AGREES
    assert ranked("b", terms, played, "b.")["verdict"] == Verdict.CONTRADICTS


def test_a_contradiction_among_many_comparisons_needs_more_evidence() -> None:
    # θ̂_R differs by 1 rad within noise: p is between 0.01 and 0.05.
    calm = [0.5, 0.9, 0.2, 0.8, 0.3]
    played = {"level": episodes(ROUGH, 8, 0.0), "planner": episodes(calm, 8, -20.0)}
    alone = ranked("smooth", TERMS, played)
    assert alone["verdict"] == Verdict.CONTRADICTS
    (found,) = alone["contradictions"]
    assert 0.001 < found["p"] == found["p_holm"] < 0.05
    count = round(0.05 / found["p"]) + 1
    equal = {"level": episodes(ROUGH, 8, 0.0), "planner": episodes(ROUGH, 8, 0.0)}
    others = [on_scene(rank("smooth", TERMS, equal)) for _ in range(count)]
    for scene in decide([on_scene(rank("smooth", TERMS, played)), *others]):
        assert [r["verdict"] for r in scene["rankings"]] == [Verdict.AGREES]
        assert scene["rankings"][0]["contradictions"] == []


def test_the_audit_pays_what_the_evaluation_pays() -> None:
    source = PolicySource(settings={"name": "okada"})
    config = EvalConfig(
        terrain="step", rewards={"pitch": "pitch", "travel": "travel"}, eval={"seed": 5}
    )
    found = audit(config, source, episodes=2)
    runner = EpisodeRunner(config, source, 5)
    results = [runner.play(0), runner.play(1)]
    assert found["decisions"] == sum(result["decisions"] for result in results)
    mean = sum(result["return"] for result in results) / 2
    assert found["return"] == pytest.approx(mean)
    for name, term in found["terms"].items():
        paid = sum(result[f"reward_{name}"] for result in results) / found["decisions"]
        assert term["mean"] == pytest.approx(paid)
        assert term["lowest"] <= term["mean"] <= term["highest"]
    assert sum(term["share"] for term in found["terms"].values()) == pytest.approx(1.0)


def test_an_audit_tells_what_never_matters_from_what_says_nothing() -> None:
    # On flat ground with level flippers the chassis does not swing; each decision of the end pays
    # 0 but the last, which pays 10.
    rewards = {"pitch": "pitch", "end": "end", "nothing": {"name": "travel", "weight": 0.0}}
    config = EvalConfig(terrain="flat", rewards=rewards)
    found = audit(config, PolicySource(settings={"name": "level"}), episodes=2)
    pitch, end, nothing = (found["terms"][name] for name in rewards)
    assert (end["lowest"], end["highest"], end["saturated"]) == (0.0, 10.0, None)
    assert end["mean"] == pytest.approx(20.0 / found["decisions"])
    assert found["return"] == pytest.approx(10.0, abs=1e-3)
    assert end["share"] == pytest.approx(1.0, abs=1e-3)
    assert pitch["saturated"] == 0.0
    assert (nothing["weight"], nothing["share"], nothing["saturated"]) == (0.0, 0.0, None)
