"""Statistics of episodes, by hand."""

import pytest

from flipperctl.evaluation.results import Interval, Outcomes, Passable, Summary
from flipperctl.evaluation.statistics import (
    differences,
    interval,
    measure,
    paired,
    proportion,
    reached,
    success_rate,
    summarise,
)
from tests.evaluation.samples import sample


def test_the_interval_of_equal_values_is_a_point() -> None:
    assert interval([2.0, 2.0, 2.0]) == Interval(2.0, 2.0, 2.0)
    with pytest.raises(ValueError, match="at least one value"):
        interval([])


def test_an_interval_covers_the_mean_as_the_normal_approximation_says() -> None:
    # 50 zeros and 50 ones: the mean's standard error is 0.5 / √100 = 0.05, so ± 1.96 · 0.05.
    found = interval([0.0] * 50 + [1.0] * 50)
    assert found.mean == 0.5
    assert found.low == pytest.approx(0.402, abs=0.011)
    assert found.high == pytest.approx(0.598, abs=0.011)


def test_an_interval_of_two_values_ends_at_them() -> None:
    # A quarter of the resamples hold twice the smaller value, a quarter twice the larger one.
    assert interval([1.0, 3.0]) == Interval(2.0, 1.0, 3.0)
    assert measure([1.0, 3.0]).range == 2.0


def test_the_interval_of_a_rate_is_wilsons() -> None:
    # z² = 3.84146. Of 5 of 5: low = 5 / (5 + z²); of 0 of 5: high = z² / (5 + z²).
    assert proportion(5, 5) == Interval(1.0, pytest.approx(0.56552, abs=1e-5), 1.0)
    assert proportion(0, 5) == Interval(0.0, 0.0, pytest.approx(0.43448, abs=1e-5))
    # Of 50 of 100: 0.5 ± z · √(0.25 / (100 + z²)) = 0.5 ± 0.09617.
    assert proportion(50, 100).low == pytest.approx(0.40383, abs=1e-5)
    assert proportion(50, 100).high == pytest.approx(0.59617, abs=1e-5)
    # Of 9 of 10: centre (0.9 + 0.192073) / 1.384146 = 0.788987, half width 0.193136.
    assert proportion(9, 10).low == pytest.approx(0.59585, abs=1e-5)
    assert proportion(9, 10).high == pytest.approx(0.98212, abs=1e-5)
    assert all(proportion(k, n).high <= 1 for n in range(1, 60) for k in range(n + 1))
    assert all(proportion(k, n).low >= 0 for n in range(1, 60) for k in range(n + 1))
    with pytest.raises(ValueError, match="at least one outcome"):
        proportion(0, 0)


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


def test_what_only_a_crossing_gives_is_none_where_nobody_crossed() -> None:
    found = summarise("step", [sample(0, "overturned", 1.0)])
    assert (found.t_cost, found.pitch_variation, found.flipper_travel) == (None, None, None)
    assert found.success == proportion(0, 1)
    assert found.max_pitch.mean == pytest.approx(0.1)
    with pytest.raises(ValueError, match="at least one outcome"):
        summarise("step", [])


def test_whoever_else_crosses_makes_a_draw_passable() -> None:
    crossed = {0: "mine", 1: "planner", 2: ""}
    episodes = [
        sample(i, "stuck" if i else "reached", 1.0, crossed_by=label)
        for i, label in crossed.items()
    ]
    found = summarise("step", episodes)
    assert found.success_rate == pytest.approx(1 / 3)
    assert found.passable == Passable(2, 0.5, proportion(1, 2))
    assert summarise("step", episodes[2:]).passable == Passable(0, None, None)


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


def test_pairs_are_equal_draws_on_which_both_reached_the_finish() -> None:
    ours = [sample(0, "reached", 1.0), sample(1, "reached", 2.0), sample(2, "stuck", 9.0)]
    theirs = [sample(2, "reached", 1.0), sample(1, "stuck", 0.0), sample(0, "reached", 1.5)]
    assert paired(ours, theirs) == [(ours[0], theirs[2])]
    found = differences(ours, theirs)
    assert found.pitch_variation is not None
    assert (found.pitch_variation.mean, found.pitch_variation.episodes) == (-0.5, 1)
    assert found.pitch_variation_100hz is not None
    assert found.pitch_variation_100hz.mean == -1.0
    assert found.t_cost is not None
    assert found.t_cost.mean == -5.0
    assert differences(ours[2:], theirs).pitch_variation is None


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
    assert success_rate(rows) == 0.5
