"""Resemblances, worked by hand, and the sign of a failure."""

import math

import numpy as np
import pytest

from flipperctl.core.risk import (
    SCALE,
    Recurrence,
    RiskCalibration,
    RiskSign,
    resemblances,
    with_recurrence,
)


def test_resemblances_compare_with_the_observations_some_decisions_ago() -> None:
    rows = np.zeros((4, 2), np.float32)
    rows[1] = SCALE, SCALE  # differs by the scale in the mean
    found = resemblances(rows)
    near = math.exp(-1)
    assert found[0].tolist() == [0, 0, 0, 0, 0]
    assert found[1].tolist() == pytest.approx([near, 0, 0, 0, 0])
    assert found[2].tolist() == pytest.approx([near, 1, 0, 0, 0])
    assert found[3].tolist() == pytest.approx([1, near, 0, 0, 0])


def test_one_observation_after_the_other_gives_the_same_as_all_at_once() -> None:
    rows = np.random.default_rng(0).normal(0, 0.02, (40, 18)).astype(np.float32)
    recurrence = Recurrence(18)
    for _ in range(2):  # a second episode forgets the first
        one_by_one = np.array([recurrence.add(row) for row in rows])
        assert one_by_one == pytest.approx(resemblances(rows), abs=1e-6)
        recurrence.reset()


def test_recurrence_adds_to_the_log_odds() -> None:
    half, none = np.array([2.0, 1.0], np.float32), np.zeros(2, np.float32)
    assert with_recurrence(0.2, half, none) == pytest.approx(0.2)
    # log-odds of ln(1/4) + 2 · 0.5 + 1 · 0.25
    found = with_recurrence(0.2, half, np.array([0.5, 0.25], np.float32))
    assert found == pytest.approx(1 / (1 + 4 * math.exp(-1.25)))
    assert 0 < with_recurrence(0.0, none, none) < with_recurrence(1.0, none, none) < 1


def test_a_calibration_is_read_back_from_the_metrics_of_a_validation() -> None:
    made = RiskCalibration(RiskSign(10, 0.3), 1.2, -1.5)
    assert RiskCalibration.of({**made.to_metrics(), "t_cost": 20.0}) == made
    for wrong in ({"risk_slope": 0.0}, {"risk_threshold": 0.0}, {"risk_horizon": 2.5}):
        with pytest.raises(ValueError, match="not possible"):
            RiskCalibration.of({**made.to_metrics(), **wrong})
    with pytest.raises(ValueError, match="risk_horizon is missing"):
        RiskCalibration.of({"t_cost": 20.0})


def test_a_risk_at_the_threshold_is_a_warning_and_an_unknown_one_is_none() -> None:
    sign = RiskSign(10, 0.3)
    assert [sign.warns(risk) for risk in (None, 0.29, 0.3)] == [False, False, True]
