"""Intervals over training seeds and episodes, and aggregates worked by hand."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import t as student

from flipperctl.evaluation.seeds import (
    PRICE,
    Scores,
    SeedSamples,
    better_interval,
    difference_interval,
    improvement,
    interquartile_mean,
    mean_interval,
    means,
    profile,
    resampled,
    score_interval,
    statistic_interval,
)
from flipperctl.evaluation.statistics import Interval, interval


def crossed(rng: np.random.Generator, seeds: int, own: float, ground: float, both: float) -> object:
    size = (seeds, 30)
    return (
        rng.normal(0, own, (seeds, 1)) + rng.normal(0, ground, (1, 30)) + rng.normal(0, both, size)
    )


def test_one_seed_has_students_interval_over_its_episodes() -> None:
    values = [1.0, 2.0, 4.0, 3.0, 7.0]
    found, expected = mean_interval({"stair": np.array([values])}), interval(values)
    assert (found.mean, found.low, found.high) == pytest.approx(
        (expected.mean, expected.low, expected.high)
    )


def test_seeds_that_differ_alone_have_students_interval_over_seeds() -> None:
    # Each episode is the same, so all variation is that of the seeds' values.
    values = [1.0, 2.0, 4.0, 3.0, 7.0]
    found = mean_interval({"stair": np.repeat(np.array(values)[:, None], 6, axis=1)})
    expected = interval(values)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))


def test_episodes_that_all_seeds_share_do_not_count_several_times() -> None:
    # Five equal seeds know no more about the ground than one does.
    values = np.array([[1.0, 2.0, 4.0, 3.0, 7.0]])
    one, five = (mean_interval({"stair": np.repeat(values, n, axis=0)}) for n in (1, 5))
    assert (five.low, five.high) == pytest.approx((one.low, one.high))


def test_scenes_weigh_the_same_whatever_their_number_of_episodes() -> None:
    found = mean_interval({"a": np.full((2, 5), 1.0), "b": np.full((2, 50), 3.0)})
    assert found.mean == 2.0
    few = mean_interval({"a": np.full((2, 4), 1.0), "b": np.full((2, 50), 3.0)})
    assert (few.mean, few.low, few.high) == (2.0, None, None)


def test_paired_episodes_make_a_difference_narrow() -> None:
    rng = np.random.default_rng(0)
    ground = rng.normal(2, 1, (1, 40))
    ours, theirs = (ground + d + rng.normal(0, 0.01, (1, 40)) for d in (0.0, 0.1))
    found, p = difference_interval({"a": ours}, {"a": theirs})
    assert found.mean == pytest.approx(-0.1, abs=0.01)
    assert found.low is not None
    assert found.high is not None
    assert found.high - found.low < 0.02
    assert p < 1e-6
    better = better_interval({"a": ours}, {"a": theirs})
    few = better_interval({"a": np.vstack([ours, ours])}, {"a": theirs})
    assert (few.mean, few.low) == (1.0, None)
    assert better.mean == 1.0
    assert better_interval({"a": ours}, {"a": ours}).mean == 0.5


def test_few_seeds_have_their_own_quantile_and_p_value() -> None:
    # Two seeds, 0 and 2, and equal episodes: mean 1, error 1, t(1) = 12.706; p = 0.5.
    scores = np.repeat([[0.0], [2.0]], 5, axis=1)
    found = mean_interval({"a": scores})
    assert found.high == pytest.approx(1 + 12.7062, abs=1e-4)
    _, p = difference_interval({"a": scores}, {"a": np.zeros((1, 5))})
    assert p == pytest.approx(0.5, abs=1e-9)


def test_what_neither_seed_nor_episode_explains_counts_once() -> None:
    # The sums over seeds, A, and over episodes, B, both contain the residual C (Satterthwaite).
    scores = np.add.outer(np.array([0.0, 1, 2, 3, 4]), np.array([0.0, 3, 6, 9, 12]))
    scores += np.diag([1.0, -1, 1, -1, 1])
    left = scores - scores.mean(axis=0) - scores.mean(axis=1, keepdims=True) + scores.mean()
    a, b = (np.var(scores.mean(axis=axis), ddof=1) / 5 for axis in (1, 0))
    c = (left**2).sum() / 16 / 25
    variance = a + b - c
    freedom = variance**2 / (a**2 / 4 + b**2 / 4 + c**2 / 16)
    half = student.ppf(0.975, freedom) * math.sqrt(variance)
    found = mean_interval({"a": scores})
    assert (found.low, found.high) == pytest.approx((found.mean - half, found.mean + half))


def test_the_jackknife_of_a_mean_is_students_interval() -> None:
    values = [1.0, 2.0, 4.0, 3.0, 7.0]
    found = statistic_interval(
        {"a": np.array([values])}, lambda m: m.mean(axis=(-2, -1)), np.random.default_rng(0)
    )
    expected = interval(values)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))


def test_a_difference_without_variation_is_certain() -> None:
    one, none = np.ones((1, 5)), np.zeros((1, 5))
    assert difference_interval({"a": one}, {"a": none})[1] == 0
    assert difference_interval({"a": one}, {"a": one})[1] == 1


@pytest.mark.parametrize("seeds", [3, 5])
def test_intervals_of_few_seeds_hold_the_truth(seeds: int) -> None:
    rng = np.random.default_rng(3)
    held = iqm = 0
    for _ in range(200):
        scores = {"a": crossed(rng, seeds, 0.5, 0.1, 0.1)}
        ours = mean_interval(scores)
        middle = statistic_interval(scores, interquartile_mean, rng, 100)
        held += ours.low <= 0 <= ours.high
        iqm += middle.low <= 0 <= middle.high
    deviation = math.sqrt(200 * 0.95 * 0.05)
    assert held > 190 - 4 * deviation
    assert iqm > 190 - 4 * deviation


def test_paired_intervals_of_several_scenes_and_seeds_hold_the_truth() -> None:
    """Seeds, episodes and what neither explains have equal parts in the variance of the mean."""
    rng, size, scenes, count = np.random.default_rng(4), 40, 2, 1000
    own, ground = 1 / math.sqrt(scenes * size), 1 / math.sqrt(size)

    def scores() -> dict[str, np.ndarray]:
        of_seed = rng.normal(0, own, (size, 1))  # a policy drives all scenes
        return {
            scene: of_seed + rng.normal(0, ground, (1, size)) + rng.normal(0, 1, (size, size))
            for scene in "ab"
        }

    intervals = [difference_interval(scores(), scores())[0] for _ in range(count)]
    inside = sum(found.low <= 0 <= found.high for found in intervals)
    assert abs(inside - 0.95 * count) < 4 * math.sqrt(count * 0.95 * 0.05)


def test_samples_draw_the_same_seeds_in_every_scene_and_the_same_episodes_for_every_seed() -> None:
    first = np.array([[1.0, 2.0, 4.0], [11.0, 12.0, 14.0]])  # the seeds differ by 10
    second = np.repeat([[3.0], [13.0]], 5, axis=1)
    drawn = resampled({"a": first, "b": second}, np.random.default_rng(0), 500)
    assert drawn.shape == (500, 2, 2)
    assert set(drawn[..., 1].round(9).ravel().tolist()) == {3.0, 13.0}
    own = drawn[..., 0] - (drawn[..., 1] - 3.0)  # of the episodes alone
    assert own[:, 0] == pytest.approx(own[:, 1])
    assert own.mean() == pytest.approx(7 / 3, abs=0.1)
    assert resampled({"a": np.zeros((2, 3, 4))}, np.random.default_rng(0), 5).shape == (5, 2, 4, 1)


def test_the_interquartile_mean_leaves_out_a_quarter_at_each_end() -> None:
    scores = np.array([[0.0, 100.0], [1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    assert interquartile_mean(scores) == 3.5  # of 2, 3, 4, 5
    assert interquartile_mean(np.array([[1.0], [2.0], [9.0]])) == 4.0


def test_ties_are_half_an_improvement() -> None:
    ours, theirs = np.array([[1.0, 5.0], [2.0, 5.0]]), np.array([[1.0, 5.0], [1.5, 6.0]])
    # Task 1: 1 = 1, 1 < 1.5, 2 > both: 2.5 of 4; task 2: two ties of 4: 1 of 4.
    assert improvement(ours, theirs) == (2.5 / 4 + 1 / 4) / 2


def test_the_profile_counts_what_is_above_a_level() -> None:
    levels = np.array([0.0, 1.0, 2.5])
    assert profile(np.array([[1.0, 2.0], [3.0, 1.0]]), levels) == pytest.approx([1.0, 0.5, 0.25])


def test_failing_costs_the_price_and_a_crossing_at_most_that() -> None:
    """What rocks more and fails is no crossing."""
    values = {"stair": np.array([[1.0, 9.0], [7.0, 2.0]]), "step": np.array([[0.5], [0.5]])}
    reached = {"stair": np.array([[True, False], [True, True]]), "step": np.ones((2, 1), bool)}
    method = SeedSamples("m", values, reached)
    assert method.scores(6.0)["stair"].tolist() == [[1.0, 6.0], [6.0, 2.0]]
    assert means(method.scores(8.0)).tolist() == [[4.5, 0.5], [4.5, 0.5]]
    assert method.seeds == 2


def middle(scores: Scores) -> Interval:
    return statistic_interval(scores, interquartile_mean, np.random.default_rng(4), 100)


@pytest.mark.parametrize("interval", [mean_interval, middle])
@pytest.mark.parametrize(("seeds", "hard"), [(1, 0.0), (5, 0.0), (5, 0.7)])
def test_the_interval_of_a_score_counts_on_failures_that_were_not_seen(
    seeds: int, hard: float, interval: Callable[[Scores], Interval]
) -> None:
    """30 episodes of which 3 % fail: of all alike, or mostly of ground that is hard for all."""
    rng, count, held = np.random.default_rng(3), 300, 0
    chance = np.array([0.5, 0.03 * (1 - hard)])
    share = 0.06 * hard
    truth = 1.0 + (PRICE - 1.0) * float(chance @ [share, 1 - share])
    for _ in range(count):
        lost = rng.random((seeds, 30)) < np.where(rng.random(30) < share, *chance)
        values = rng.lognormal(-0.045, 0.3, 30) * rng.lognormal(-0.005, 0.1, (seeds, 30))
        score = score_interval(SeedSamples("m", {"s": values}, {"s": ~lost}), PRICE, interval)
        assert score.low is not None
        assert score.high is not None
        held += score.low <= truth <= score.high
    assert held >= 0.93 * count
