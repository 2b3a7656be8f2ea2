"""Which failures a risk announced, counted by hand."""

import pytest

from flipperctl.core.risk import RiskSign
from flipperctl.evaluation.views.summary import summarise, summary, threshold_for
from flipperctl.rollout.episode import EpisodeRisks
from tests.evaluation.samples import episodes, sample

SIGN = RiskSign(horizon=6, threshold=0.5)


def risks(*told: float) -> EpisodeRisks:
    return EpisodeRisks.of(SIGN, told)


@pytest.mark.parametrize(
    ("warned_at", "in_time"),
    [(9, False), (7, False), (6, True), (4, True), (3, False)],  # of the decisions 0 to 9
)
def test_a_warning_is_in_time_within_the_horizon_and_three_decisions_ahead(
    warned_at: int, in_time: bool
) -> None:
    assert risks(*(0.9 if t == warned_at else 0.1 for t in range(10))).in_time is in_time


def test_an_episode_shorter_than_the_horizon_can_be_announced() -> None:
    assert risks(0.9, 0, 0, 0).in_time
    assert not risks(0.9, 0, 0).in_time


def test_counts_and_scores_are_those_worked_by_hand() -> None:
    found = summarise(
        [
            (risks(*[0.0] * 4, *[1.0] * 6), True),  # announced, and right at each decision
            (risks(*[0.0] * 10), True),  # not announced: wrong at 6 of 10
            (risks(*[0.0] * 9, 0.5), False),  # a false alarm at its last decision
            (risks(*[0.0] * 10), False),
        ]
    )
    assert found is not None
    names = ("failures", "announced", "reached", "false_alarms")
    assert [found[name] for name in names] == [2, 1, 2, 1]
    assert found["false_warnings"] == pytest.approx(1 / 20)
    assert found["brier"] == pytest.approx((6 + 0.25) / 40)
    assert found["brier_of_mean"] == pytest.approx(0.3 * 0.7)  # 12 of 40 came before a failure
    first, *_, last = found["bins"]
    assert (first["decisions"], first["true"]) == (33, pytest.approx(6 / 33))
    assert (last["decisions"], last["told"], last["true"]) == (6, 1.0, 1.0)
    assert summarise([]) is None


def test_a_threshold_lies_above_the_episodes_that_must_not_warn() -> None:
    reached = [(risks(0.1 * i), False) for i in range(1, 6)]
    assert 0.5 < threshold_for(reached, 0.0, 0.05) < 0.501
    assert 0.4 < threshold_for(reached, 0.2, 0.05) < 0.401
    assert threshold_for(reached, 1.0, 0.05) == 0.05
    assert threshold_for([(risks(1.0), False)], 0.0, 0.05) == 1.0
    assert threshold_for([(risks(1.0), True)], 0.0, 0.05) == 0.05


def test_a_summary_has_the_risk_of_a_policy_that_tells_one() -> None:
    told = [
        sample(0, "reached", 1.0, **risks(0.9).to_row()),
        sample(1, "stuck", 1.0, **risks(0.1).to_row()),
    ]
    found = summary("step", episodes(told))["risk"]
    assert (found["false_alarms"], found["announced"], found["threshold"]) == (1, 0, 0.5)
    assert "risk" not in summary("step", episodes([sample(0, "reached", 1.0)]))
