"""Summaries and differences of episodes, and which failures a risk announced, by hand."""

import pytest

from flipperctl.core.risk import RiskSign
from flipperctl.evaluation.statistics import paired_success, proportion
from flipperctl.rollout.risks import EpisodeRisks, threshold_for
from flipperctl.views.summary import difference, estimate, summarise, summary
from tests.evaluation.samples import episodes, sample

pytestmark = pytest.mark.usefixtures("core_measures")


def test_a_summary_counts_outcomes_and_averages_what_reached_the_finish() -> None:
    rows = [
        sample(0, "reached", 1.0),
        sample(1, "reached", 3.0),
        sample(2, "stuck", 99.0),
        sample(3, "timeout", 17.0),
    ]
    found = summary("step", episodes(rows))
    assert (found["terrain"], found["episodes"], found["success_rate"]) == ("step", 4, 0.5)
    assert found["success"] == proportion(2, 4).to_dict()
    assert found["outcomes"] == {"reached": 2, "overturned": 0, "stuck": 1, "timeout": 1}
    assert found["pitch_variation_decisions"] == estimate([1.0, 3.0])
    assert found["pitch_variation_100hz"] == estimate([2.0, 6.0])
    assert found["t_cost"] == estimate([10.0, 30.0])
    assert found["flipper_travel"] == estimate([3.0, 9.0])
    # These two are of all episodes.
    assert found["max_pitch"] == estimate([0.1 * value for value in (1.0, 3.0, 99.0, 17.0)])
    assert found["return"] == estimate([-1.0, -3.0, -99.0, -17.0])
    assert (found["return"]["mean"], found["return"]["range"]) == (-30.0, 98.0)
    assert not {"passable", "parts"} & found.keys()
    assert found["not_reached"] == {
        "episodes": 2,
        "duration": estimate([990.0, 170.0]),
        "pitch_variation": estimate([99.0, 17.0]),
        "pitch_variation_decisions": estimate([99.0, 17.0]),
        "pitch_variation_100hz": estimate([198.0, 34.0]),
        "flipper_travel": estimate([297.0, 51.0]),
        "decisions": found["not_reached"]["decisions"],
    }
    assert summary("step", episodes(rows[:2]))["not_reached"] is None


def test_what_only_a_crossing_gives_is_none_where_nobody_crossed() -> None:
    found = summary("step", episodes([sample(0, "overturned", 1.0)]))
    assert [found[name] for name in ("t_cost", "pitch_variation_decisions", "flipper_travel")] == [
        None
    ] * 3
    assert found["success"] == proportion(0, 1).to_dict()
    assert found["max_pitch"]["mean"] == pytest.approx(0.1)
    with pytest.raises(ValueError, match="at least one outcome"):
        summary("step", episodes([]))


def test_a_draw_is_passable_whatever_the_policy_does_on_it() -> None:
    # References cross draws 0 to 2; the policy crosses 0, 1 and 3.
    crossed = ("okada", "planner", "planner", "", "")
    for by_policy, passed, beyond in (((0, 1, 3), 2, 1), ((), 0, 0), ((3, 4), 0, 2)):
        outcomes = ["reached" if i in by_policy else "stuck" for i in range(5)]
        rows = [
            sample(i, outcome, 1.0, crossed_by=label)
            for i, (outcome, label) in enumerate(zip(outcomes, crossed, strict=True))
        ]
        rates = {"success_rate": passed / 3, "success": proportion(passed, 3).to_dict()}
        expected = {"episodes": 3, **rates, "beyond": beyond}
        assert summary("step", episodes(rows))["passable"] == expected
    nobody = summary("step", episodes([sample(0, "reached", 1.0, crossed_by="")]))
    none = {"episodes": 0, "success_rate": None, "success": None, "beyond": 1}
    assert nobody["passable"] == none


def test_pairs_are_equal_draws() -> None:
    ours = [sample(0, "reached", 1.0), sample(1, "reached", 2.0), sample(2, "stuck", 9.0)]
    theirs = [sample(2, "reached", 1.0), sample(1, "stuck", 0.0), sample(0, "reached", 1.5)]
    assert episodes(ours).paired(theirs) == list(zip(ours, reversed(theirs), strict=True))
    found = difference(episodes(ours), theirs)
    assert found["success"] == paired_success(1, 1, 3).to_dict()
    assert (
        found["pitch_variation_decisions"]["mean"],
        found["pitch_variation_decisions"]["episodes"],
    ) == (-0.5, 1)
    assert found["pitch_variation_100hz"]["mean"] == -1.0
    assert found["t_cost"]["mean"] == -5.0
    # Measures are compared where both reached the finish.
    rest = difference(episodes(ours[2:]), theirs)
    assert rest["pitch_variation_decisions"] is None
    assert rest["success"] == paired_success(0, 1, 1).to_dict()


def test_a_part_that_the_other_did_not_play_is_not_compared() -> None:
    """As when Ctrl-C ended a baseline on a mix."""
    ours = [sample(0, "reached", 1.0), sample(1, "reached", 2.0, terrain="stair")]
    found = difference(episodes(ours), [sample(0, "reached", 1.5)])
    assert list(found["parts"]) == ["step"]
    assert found["success"]["episodes"] == 1


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
