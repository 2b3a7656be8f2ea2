"""Statistics of episodes, by hand."""

import pytest

from flipperctl.evaluation.intervals import paired_success, proportion
from flipperctl.evaluation.results import Outcomes, Passable, Summary
from flipperctl.evaluation.statistics import (
    differences,
    measure,
    paired,
    reached,
    summarise,
)
from tests.evaluation.samples import sample

pytestmark = pytest.mark.usefixtures("core_measures")


def test_a_summary_counts_outcomes_and_averages_what_reached_the_finish() -> None:
    episodes = [
        sample(0, "reached", 1.0),
        sample(1, "reached", 3.0),
        sample(2, "stuck", 99.0),
        sample(3, "timeout", 17.0),
    ]
    found = summarise("step", episodes)
    assert (found.terrain, found.episodes, found.success_rate) == ("step", 4, 0.5)
    assert found.success == proportion(2, 4)
    assert found.outcomes == Outcomes(reached=2, overturned=0, stuck=1, timeout=1)
    assert found.pitch_variation == measure([1.0, 3.0])
    assert found.pitch_variation_100hz == measure([2.0, 6.0])
    assert found.t_cost == measure([10.0, 30.0])
    assert found.flipper_travel == measure([3.0, 9.0])
    # These two are of all episodes.
    assert found.max_pitch == measure([0.1 * value for value in (1.0, 3.0, 99.0, 17.0)])
    assert found.episode_return == measure([-1.0, -3.0, -99.0, -17.0])
    assert (found.episode_return.mean, found.episode_return.range) == (-30.0, 98.0)
    assert found.passable is None
    assert found.parts == {}
    assert found.not_reached is not None
    assert found.not_reached.episodes == 2
    assert found.not_reached.pitch_variation_100hz == measure([198.0, 34.0])
    assert found.not_reached.pitch_variation == measure([99.0, 17.0])
    assert found.not_reached.flipper_travel == measure([297.0, 51.0])
    assert found.not_reached.duration == measure([990.0, 170.0])
    assert summarise("step", episodes[:2]).not_reached is None


def test_what_only_a_crossing_gives_is_none_where_nobody_crossed() -> None:
    found = summarise("step", [sample(0, "overturned", 1.0)])
    assert (found.t_cost, found.pitch_variation, found.flipper_travel) == (None, None, None)
    assert found.success == proportion(0, 1)
    assert found.max_pitch.mean == pytest.approx(0.1)
    with pytest.raises(ValueError, match="at least one outcome"):
        summarise("step", [])


def test_a_draw_is_passable_whatever_the_policy_does_on_it() -> None:
    # References cross draws 0 to 2; the policy crosses 0, 1 and 3.
    crossed = ("okada", "planner", "planner", "", "")
    for reached_by_policy, passed, beyond in (((0, 1, 3), 2, 1), ((), 0, 0), ((3, 4), 0, 2)):
        found = summarise(
            "step",
            [
                sample(i, "reached" if i in reached_by_policy else "stuck", 1.0, crossed_by=label)
                for i, label in enumerate(crossed)
            ],
        )
        assert found.passable == Passable(3, passed / 3, proportion(passed, 3), beyond)
    nobody = summarise("step", [sample(0, "reached", 1.0, crossed_by="")])
    assert nobody.passable == Passable(0, None, None, 1)


def test_a_summary_takes_a_mix_apart() -> None:
    episodes = [
        sample(0, "stuck", 9.0, "wave"),
        sample(1, "reached", 1.0, "gap"),
        sample(2, "reached", 3.0, "gap"),
    ]
    found = summarise("mix", episodes)
    assert found.success_rate == pytest.approx(2 / 3)
    assert list(found.parts) == ["gap", "wave"]
    assert found.parts["gap"] == summarise("gap", episodes[1:])
    assert found.parts["wave"] == summarise("wave", episodes[:1])
    assert isinstance(found.parts["gap"], Summary)
    assert (found.parts["gap"].episodes, found.parts["gap"].success_rate) == (2, 1.0)
    assert (found.parts["wave"].episodes, found.parts["wave"].success_rate) == (1, 0.0)


def test_pairs_are_equal_draws() -> None:
    ours = [sample(0, "reached", 1.0), sample(1, "reached", 2.0), sample(2, "stuck", 9.0)]
    theirs = [sample(2, "reached", 1.0), sample(1, "stuck", 0.0), sample(0, "reached", 1.5)]
    assert paired(ours, theirs) == list(zip(ours, reversed(theirs), strict=True))
    found = differences(ours, theirs)
    assert found.success == paired_success(1, 1, 3)
    assert found.pitch_variation is not None
    assert (found.pitch_variation.mean, found.pitch_variation.episodes) == (-0.5, 1)
    assert found.pitch_variation_100hz is not None
    assert found.pitch_variation_100hz.mean == -1.0
    assert found.t_cost is not None
    assert found.t_cost.mean == -5.0
    # Measures are compared where both reached the finish.
    assert differences(ours[2:], theirs).pitch_variation is None
    assert differences(ours[2:], theirs).success == paired_success(0, 1, 1)


def test_a_mix_is_compared_part_by_part_on_equal_draws() -> None:
    labels = ("gap", "gap", "wave")
    ours, theirs = (
        [sample(i, "reached", v, t) for i, (v, t) in enumerate(zip(values, labels, strict=True))]
        for values in ((1.0, 2.0, 3.0), (2.0, 3.0, 9.0))
    )
    found = differences(ours, theirs)
    assert found.pitch_variation is not None
    assert found.pitch_variation.mean == pytest.approx((-1 - 1 - 6) / 3)
    gap, wave = (found.parts[label].pitch_variation for label in ("gap", "wave"))
    assert gap is not None
    assert wave is not None
    assert (gap.mean, gap.episodes) == (-1.0, 2)
    assert (wave.mean, wave.episodes) == (-6.0, 1)
    assert differences(ours[:2], theirs[:2]).parts == {}


def test_rows_of_a_training_are_counted_alike() -> None:
    rows = [{"outcome": "reached"}, {"outcome": "stuck"}, {"outcome": "reached"}, {"outcome": ""}]
    assert reached(rows) == [rows[0], rows[2]]


def test_a_part_that_the_other_did_not_play_is_not_compared() -> None:
    """As when Ctrl-C ended a baseline on a mix."""
    ours = [sample(0, "reached", 1.0), sample(1, "reached", 2.0, terrain="stair")]
    found = differences(ours, [sample(0, "reached", 1.5)])
    assert list(found.parts) == ["step"]
    assert found.success.episodes == 1
