"""Aggregates worked by hand."""

import math

import numpy as np
import pytest

from flipperctl.evaluation.seeds import (
    PRICE,
    Method,
    improvement,
    interquartile_mean,
    means,
    profile,
)


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


def test_an_episode_that_is_not_reached_costs_the_price() -> None:
    values = {"stair": np.array([[1.0, 0.2], [7.0, 2.0]])}
    method = Method("m", values, {"stair": np.array([[True, False], [True, True]])})
    assert method.scores(PRICE)["stair"].tolist() == [[1.0, 2 * math.pi], [7.0, 2.0]]
    assert means(method.scores(5.0)).tolist() == [[3.0], [4.5]]
    assert method.above(PRICE) == 1
    assert method.seeds == 2
