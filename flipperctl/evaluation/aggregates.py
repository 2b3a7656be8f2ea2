"""Figures over training seeds, by the definitions of rliable (Agarwal et al., NeurIPS 2021).

In: scores of R runs (training seeds) on T tasks (scenes), (R, T), of which greater ones are better
where a function says so. Out: one number, or a curve. rliable 1.2 itself is not a dependency:
``benchmarks/agreement.py`` compares both.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from flipperctl.api import FloatArray

TRIM = 0.25
"""Fraction of the scores that an interquartile mean leaves out at each end [-]."""

Statistic = Callable[[FloatArray], FloatArray]
"""Returns one number for each matrix of scores, (..., R, T) → (...)."""


def mean(scores: FloatArray) -> FloatArray:
    """Return the mean over runs and tasks, (..., R, T) → (...)."""
    return np.asarray(scores.mean(axis=(-2, -1)))


def interquartile_mean(scores: FloatArray) -> FloatArray:
    """Return the mean of the middle half of all runs and tasks, (..., R, T) → (...).

    The ⌊R·T/4⌋ smallest and equally many of the largest scores are left out, so it equals the mean
    for up to three scores.
    """
    flat = np.sort(scores.reshape(*scores.shape[:-2], -1), axis=-1)
    cut = int(TRIM * flat.shape[-1])
    return np.asarray(flat[..., cut : flat.shape[-1] - cut].mean(axis=-1))


def improvement(ours: FloatArray, theirs: FloatArray) -> FloatArray:
    """Return the probability that a run of ours beats one of theirs, where greater is better.

    It is P(X > Y) + P(X = Y) / 2 over all pairs of runs (Mann and Whitney's U over R·R'), averaged
    over the tasks: (..., R, T) and (..., R', T) → (...).
    """
    gap = ours[..., :, None, :] - theirs[..., None, :, :]  # (..., R, R', T)
    return np.asarray(((gap > 0) + 0.5 * (gap == 0)).mean(axis=(-3, -2, -1)))


def profile(scores: FloatArray, levels: FloatArray) -> FloatArray:
    """Return the fraction of all scores above each of L levels, (L,): the performance profile.

    ``scores`` may have any shape: runs × tasks, as in rliable, or runs × episodes.
    """
    ordered = np.sort(scores, axis=None)
    below = np.searchsorted(ordered, levels, side="right")
    return np.asarray(1.0 - below / ordered.size)


def percentile_ends(values: FloatArray) -> FloatArray:
    """Return the percentile interval: the 2.5 % and 97.5 % quantiles of (B,) resampled values."""
    return np.asarray(np.percentile(values, [2.5, 97.5]))
