"""Summaries and differences of episodes, by hand."""

import pytest

from flipperctl.evaluation.statistics import paired_success, proportion
from flipperctl.evaluation.views.summary import difference, estimate, summary
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
    assert found["pitch_variation"] == estimate([1.0, 3.0])
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
        "pitch_variation_100hz": estimate([198.0, 34.0]),
        "flipper_travel": estimate([297.0, 51.0]),
    }
    assert summary("step", episodes(rows[:2]))["not_reached"] is None


def test_what_only_a_crossing_gives_is_none_where_nobody_crossed() -> None:
    found = summary("step", episodes([sample(0, "overturned", 1.0)]))
    assert [found[name] for name in ("t_cost", "pitch_variation", "flipper_travel")] == [None] * 3
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
    assert (found["pitch_variation"]["mean"], found["pitch_variation"]["episodes"]) == (-0.5, 1)
    assert found["pitch_variation_100hz"]["mean"] == -1.0
    assert found["t_cost"]["mean"] == -5.0
    # Measures are compared where both reached the finish.
    rest = difference(episodes(ours[2:]), theirs)
    assert rest["pitch_variation"] is None
    assert rest["success"] == paired_success(0, 1, 1).to_dict()


def test_a_part_that_the_other_did_not_play_is_not_compared() -> None:
    """As when Ctrl-C ended a baseline on a mix."""
    ours = [sample(0, "reached", 1.0), sample(1, "reached", 2.0, terrain="stair")]
    found = difference(episodes(ours), [sample(0, "reached", 1.5)])
    assert list(found["parts"]) == ["step"]
    assert found["success"]["episodes"] == 1
