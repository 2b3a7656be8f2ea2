"""The sign of a failure, worked by hand, and the draws of a policy that warns."""

import math

import numpy as np
import pytest

from flipperctl.core.risk import (
    LAGS,
    SCALE,
    EpisodeRisk,
    Escape,
    EscapeRule,
    RiskCalibration,
    RiskSign,
    resemblances,
    with_recurrence,
)

VALUES = [0.0, 0.1, -math.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_resemblances_compare_with_the_observations_some_decisions_ago() -> None:
    rows = np.zeros((4, 2), np.float32)
    rows[1] = SCALE, SCALE  # differs by the scale in the mean
    near = math.exp(-1)
    expected = [[0] * 5, [near, 0, 0, 0, 0], [near, 1, 0, 0, 0], [1, near, 0, 0, 0]]
    assert resemblances(rows) == pytest.approx(np.array(expected))


def test_one_observation_after_the_other_gives_the_same_as_all_at_once() -> None:
    rows = np.random.default_rng(0).normal(0, 0.02, (40, 18)).astype(np.float32)
    episode = EpisodeRisk(18, RiskSign(10, 0.5))
    for _ in range(2):  # a second episode forgets the first
        one_by_one = np.array([episode.resemblances(row) for row in rows])
        assert one_by_one == pytest.approx(resemblances(rows), abs=1e-6)
        episode.reset()


def told(episode: EpisodeRisk, *places: tuple[float, ...] | None, risk: float = 0.2) -> list[float]:
    """Return the risks of decisions at these places, all with the same observation."""
    none, seen = np.zeros(len(LAGS), np.float32), np.zeros(18, np.float32)
    return [episode.update(risk, none, seen, place) for place in places]


def test_a_robot_that_has_moved_less_than_a_fifth_of_what_its_belts_command_warns() -> None:
    episode = EpisodeRisk(18, RiskSign(10, 0.6), 0.1)  # 1 m in ten decisions
    way = [(0.1 * i, 0.0) for i in range(11)]
    assert told(episode, *way) == pytest.approx([0.2] * 11)
    pushes = [(1.0 + 0.01 * (i % 2), 0.1 * (i % 2)) for i in range(20)]  # it rocks in its place
    risks = told(episode, *pushes)
    assert risks == pytest.approx([0.2] * 8 + [0.8] * 12)  # until 0.9 m, which is 0.1 m away
    assert told(episode, (1.0, 0.0), risk=0.9) == pytest.approx([0.9])
    assert math.isnan(told(episode, (1.0, 0.0), risk=math.nan)[0])
    turned = [(1.0, 0.1 * i, 0.0) for i in range(11)]  # with a third coordinate it has turned aside
    assert told(episode, *turned)[-1] == pytest.approx(0.2)


def test_a_robot_whose_motion_is_not_known_does_not_stand() -> None:
    places = [(0.0, 0.0)] * 30
    assert max(told(EpisodeRisk(18, RiskSign(10, 0.6)), *places)) < 0.3  # of what belts command
    episode = EpisodeRisk(18, RiskSign(10, 0.6), 0.1)
    assert max(told(episode, *[None] * 30)) < 0.3
    assert told(episode, *places)[9:11] == pytest.approx([0.2, 0.8])
    assert told(episode, None, *places)[:12] == pytest.approx([0.2] * 11 + [0.8])
    episode.reset()
    assert told(episode, *places)[9:11] == pytest.approx([0.2, 0.8])


def test_recurrence_adds_to_the_log_odds() -> None:
    half, none = np.array([2.0, 1.0], np.float32), np.zeros(2, np.float32)
    assert with_recurrence(0.2, half, none) == pytest.approx(0.2)
    # log-odds of ln(1/4) + 2 · 0.5 + 1 · 0.25
    found = with_recurrence(0.2, half, np.array([0.5, 0.25], np.float32))
    assert found == pytest.approx(1 / (1 + 4 * math.exp(-1.25)))
    assert 0 < with_recurrence(0.0, none, none) < with_recurrence(1.0, none, none) < 1


def test_a_calibration_is_read_back_from_the_metrics_of_a_validation() -> None:
    sign = RiskSign(10, 0.3)
    assert [sign.warns(risk) for risk in (None, 0.29, 0.3)] == [False, False, True]
    made = RiskCalibration(sign, 1.2, -1.5)
    assert RiskCalibration.of({**made.to_metrics(), "t_cost": 20.0}) == made
    for wrong in ({"risk_slope": 0.0}, {"risk_threshold": 0.0}, {"risk_horizon": 2.5}):
        with pytest.raises(ValueError, match="not possible"):
            RiskCalibration.of({**made.to_metrics(), **wrong})
    with pytest.raises(ValueError, match="risk_horizon is missing"):
        RiskCalibration.of({"t_cost": 20.0})


def test_actions_are_drawn_from_the_warning_on_for_as_many_decisions() -> None:
    escape = Escape(EscapeRule(0.1, 3))
    warnings = [False, True, False, False, False, True, True, False, False, False]
    due = [escape.due(warns=warns) for warns in warnings]
    assert due == [False, True, True, True, False, True, True, True, True, False]
    assert escape.due(warns=True)
    escape.reset()
    assert not escape.due(warns=False)


def test_draws_follow_the_values_and_equal_episodes_have_equal_ones() -> None:
    escape = Escape(EscapeRule(0.1, 1))
    first = [escape.draw(VALUES) for _ in range(4000)]
    weights = np.exp(np.array(VALUES) / 0.1)
    counts = np.bincount(first, minlength=9)
    assert counts / 4000 == pytest.approx(weights / weights.sum(), abs=0.03)
    assert counts[2] == 0
    escape.reset()
    assert [escape.draw(VALUES) for _ in range(50)] == first[:50]
