"""``mpc`` against the environment, and its prediction model against the engine."""

import pytest

from benchmarks import lookahead, lookahead_values
from benchmarks.prediction import prediction_errors
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.lookahead.controllers import Mpc
from flipperctl.rollout.episode import play
from tests.benchmarks.small import small_benchmark


def test_rates_by_hand() -> None:
    rounds = [
        lookahead.Round([0.1, 0.3], [300, 500], 0.001),
        lookahead.Round([0.1, 0.1], [300, 300], 0.001),
    ]
    found = lookahead.rates(rounds)
    medians = {name: q["median"] for name, q in found["quantities"].items()}
    assert medians["decision"] == pytest.approx(0.1)
    assert medians["decision_p99"] == pytest.approx(0.294)  # 0.97 of the way from 0.1 to 0.3
    assert medians["simulated_per_decision"] == 300
    assert medians["simulated_decisions"] == pytest.approx(2500)  # 800 / 0.4 s, 600 / 0.2 s
    assert medians["environment_decisions"] == pytest.approx(2000)
    ratio = found["ratios"]["simulated_decisions / environment_decisions"]["ratio"]
    assert ratio == pytest.approx(1.25)


def test_rates_of_searches_on_rewards_by_hand() -> None:
    rounds = [
        lookahead_values.Round([0.1], [0.4], [1.0]).and_then(
            lookahead_values.Round([0.3], [0.2], [3.0])
        ),
        lookahead_values.Round([0.2, 0.2], [0.4], [2.0]),
    ]
    found = lookahead_values.rates(rounds)
    medians = {name: q["median"] for name, q in found["quantities"].items()}
    assert medians["decision_with_value"] == pytest.approx(0.4)
    assert medians["decision_with_value_p99"] == pytest.approx(0.4)
    assert medians["graph"] == pytest.approx(2.0)
    assert medians["decisions"] == pytest.approx(5.0)
    assert medians["decisions_with_value"] == pytest.approx((1 / 0.3 + 2.5) / 2)
    assert medians["graphs"] == pytest.approx(0.5)
    ratios = {name: ratio["ratio"] for name, ratio in found["ratios"].items()}
    assert ratios["decisions / graphs"] == pytest.approx(10)
    assert ratios["decisions / decisions_with_value"] == pytest.approx(5 / ((1 / 0.3 + 2.5) / 2))


def test_a_second_search_counts_too() -> None:
    """A plan that loses any time at all is searched for again, at thrice the width."""
    config = small_benchmark().config.environment()
    counts = {}
    for name, from_ in (("once", 100.0), ("twice", 1e-6)):
        policy = Mpc(beam=2, horizon=2, stuck_from=from_).build()
        timed = lookahead.TimedMpc(policy)
        play(FlipperEnv(config=config), timed, 1)
        counts[name] = timed.simulated
        assert len(timed.seconds) == len(timed.simulated)
    assert max(counts["once"]) <= 9 + 3 * 9  # from the root, and from the beam and the last plan
    assert max(counts["twice"]) > max(counts["once"])


def test_predictions_agree_with_the_engine() -> None:
    errors = prediction_errors(small_benchmark().config.environment(), "okada", [1, 2])
    assert sorted(errors["position"])[len(errors["position"]) // 2] < 0.01
    assert sorted(errors["pitch"])[len(errors["pitch"]) // 2] < 0.01
    assert len(errors["swing"]) == len(errors["pitch"]) > 20
