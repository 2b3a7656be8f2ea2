"""The regret of a policy, on episodes made by hand."""

from typing import Any

import pytest

from flipperctl.config import EvalConfig
from flipperctl.config.reward_sum import paying_terms
from flipperctl.errors import ConfigError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.play import Player
from flipperctl.evaluation.regret import RegretScene, Verdict, measure, regret
from flipperctl.evaluation.rows import Episodes
from flipperctl.policies.source import load_policy
from flipperctl.views.regret import falls_short, line, sentences, table
from tests.evaluation.samples import episodes as rows
from tests.evaluation.samples import sample

CONFIG = EvalConfig(terrain="step", rewards={"end": "end", "guide": "shaped_progress"})
LEVEL = [1.0, 2.0, 3.0, 4.0, 5.0]


def episodes(returns: list[float], outcome: str = "reached") -> Episodes:
    """Episodes with these returns; shaping, which is left out, would turn their order around."""
    paid = [{"reward_end": value, "reward_guide": -100 * value} for value in returns]
    return rows([sample(seed, outcome, 1.0, **own) for seed, own in enumerate(paid)])


def found(own: list[float], **others: list[float]) -> dict[str, Any]:
    references = {name: episodes(returns) for name, returns in others.items()}
    references["level"] = episodes(LEVEL[: len(own)], "stuck")
    made = regret("mine", episodes(own), references, paying_terms(CONFIG.rewards))
    conditions = Conditions.of(CONFIG).to_dict()
    return {"terrain": "step", "rewards": "own", "seed": 0, "conditions": conditions, **made}


def test_the_best_known_return_is_that_of_each_episode() -> None:
    # The best of each episode: 3, 4 (mpc), 5 (mine), 8, 9 (mpc); in the mean 5.8, level's is 3.
    one = found([3.0, 1.0, 5.0, 4.0, 2.0], mpc=[2.0, 4.0, 4.0, 8.0, 9.0], okada=[0.0] * 5)
    assert one["policy"]["return"]["mean"] == pytest.approx(3.0)
    assert one["best_known"]["return"]["mean"] == pytest.approx(29 / 5)
    assert one["policy"]["regret"]["mean"] == pytest.approx(29 / 5 - 3)
    assert one["policy"]["above_level"]["mean"] == pytest.approx(0.0)
    assert one["policy"]["fraction"] == pytest.approx(0.0)
    assert list(one["references"]) == ["mpc", "level", "okada"]
    assert one["references"]["mpc"]["fraction"] == pytest.approx((5.4 - 3) / (5.8 - 3))
    assert one["best_reference"]["name"] == "mpc"
    assert one["best_reference"]["regret"]["mean"] == pytest.approx(5.4 - 3)
    assert one["best_reference"]["fraction"] == pytest.approx(0.0)


def test_there_is_no_fraction_of_no_gain() -> None:
    one = found([0.0, 1.0, 2.0, 3.0, 4.0], okada=[-1.0] * 5)  # level is the best of each episode
    assert (one["policy"]["fraction"], one["best_reference"]["fraction"]) == (None, None)
    assert one["best_reference"]["name"] == "level"
    lucky = found([0.0] * 5, okada=[1.1, 0.0, 0.0, 0.0, 0.0])  # 0.02 more in the mean, by chance
    assert lucky["best_known"]["return"]["mean"] == pytest.approx(3.02)
    assert lucky["policy"]["fraction"] is None


@pytest.mark.parametrize(
    ("lost", "verdict"),
    [
        ([0.2, 0.3, 0.2, 0.3, 0.2], Verdict.LESS),
        ([-0.2, -0.3, -0.2, -0.3, -0.2], Verdict.MORE),
        ([2.0, -1.5, 0.2, 0.1, 0.3], Verdict.UNDECIDED),  # in the mean less, but within noise
        ([0.0] * 5, Verdict.UNDECIDED),
        ([9.0, 9.0, 9.0, 9.0], Verdict.UNDECIDED),  # four are too few
    ],
)
def test_the_verdict_is_that_of_the_paired_interval(lost: list[float], verdict: Verdict) -> None:
    one = found([level - less for level, less in zip(LEVEL, lost, strict=False)])
    assert one["verdict"] == verdict
    # The returns' own intervals overlap widely; only the pairs tell.
    ((text, is_alarm),) = sentences([one])
    alarm = "EARNS LESS THAN HOLDING THE FLIPPERS STILL"
    assert is_alarm == (verdict is Verdict.LESS)
    assert (alarm in text, alarm in line(one)) == (is_alarm, is_alarm)


def test_the_sentences_name_scene_difference_and_best_reference() -> None:
    less = found([level - 0.5 for level in LEVEL], mpc=[8.0] * 5)
    more = found([level + 0.5 for level in LEVEL], mpc=[8.0] * 5)
    first, second, mean, last = [text for text, _ in sentences([less, more])]
    assert first == (
        "mine on step: EARNS LESS THAN HOLDING THE FLIPPERS STILL, difference "
        "-0.50 [–]; to the best reference, mpc: -5.50 [-7.46, -3.54]"
    )
    assert "earns more than holding the flippers still, difference +0.50" in second
    assert mean == "share of the gain, mean of 2: 0.00"  # -0.5 / 5 and 0.5 / 5
    assert last.endswith("EARNS LESS THAN HOLDING THE FLIPPERS STILL in 1 of 2 comparisons")
    assert line(less).startswith(
        "Check on 5 new episodes, 95 % intervals in brackets: return 2.50; mpc 8.00; "
        "flippers held still 3.00.\n"
        "The policy EARNS LESS THAN HOLDING THE FLIPPERS STILL (-0.50 [–])."
    )
    assert line(None) == ""
    named = [row["policy"] for row in table([less]).rows]
    assert named == ["mine", "mpc", "level", "best of each episode"]


def scene(**more: Any) -> RegretScene:
    config = EvalConfig(terrain="flat", eval={"episodes": 2}, **more)
    sources = {name: load_policy(name, "x") for name in ("okada", "level")}
    return RegretScene(config, "own", "okada", sources["okada"], {"okada": sources["okada"]})


def measured(of: RegretScene) -> dict[str, Any] | None:
    with Player() as player:
        return measure(of, player)


def test_level_is_always_a_reference_and_the_policy_never() -> None:
    one = measured(scene())
    assert one is not None
    assert list(one["references"]) == ["level"]
    assert (one["seed"], one["conditions"]["name"], one["name"]) == (0, "nominal", "okada")


def test_shaping_alone_is_no_return() -> None:
    with pytest.raises(ConfigError, match="'own' leaves no term"):
        measured(scene(rewards={"guide": "shaped_progress"}))


@pytest.mark.parametrize(
    ("pitches", "words"),
    [
        (
            [1.4, 1.6, 1.4, 1.6, 1.5, 9.0],
            "success 83.3 %, pitch variation 1.50 rad (flippers held still: 100 %, 1.00 rad).\n"
            "It PITCHES MORE THAN HOLDING THE FLIPPERS STILL (+0.50 [",
        ),
        ([0.5] * 5 + [9.0], "\nIt pitches less than holding the flippers still (-0.50 ["),
        ([0.5, 1.6, 0.9, 1.2, 1.0, 9.0], "\nIt is not shown to pitch less than holding"),
        ([1.001] * 5 + [9.0], "\nIt is not shown to pitch less than holding"),
    ],
)
def test_a_training_that_earns_more_is_told_where_it_pitches_more(
    pitches: list[float], words: str
) -> None:
    """The last episode is not reached and does not count in θ̂_R."""
    own = [sample(s, "reached", p / 2, reward_end=9.0) for s, p in enumerate(pitches)]
    own[-1] = sample(5, "stuck", pitches[-1], reward_end=0.0)
    level = [sample(s, "reached", 0.5, reward_end=float(s)) for s in range(6)]
    text = line(regret("mine", rows(own), {"level": rows(level)}, ["end"]))
    assert "EARNS LESS" not in text
    assert words in text


@pytest.mark.parametrize(
    ("success", "low", "expected"),
    [(1.0, -0.1, False), (1.0, None, False), (1.0, 0.01, True), (0.9, -0.4, True)],
)
def test_more_training_is_advised_after_less_success_or_more_pitching(
    success: float, low: float | None, expected: bool
) -> None:
    own = {"success_rate": success, "pitch_above_level": {"low": low}}
    assert falls_short({"policy": own, "references": {"level": {"success_rate": 1.0}}}) is expected
    assert not falls_short({"policy": own, "references": {}})
    assert not falls_short(None)
