"""Learning curves of a training run.

In: the rows of ``metrics.csv`` as text. Out: a matplotlib figure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flipperctl.api import FloatArray, Outcome
from flipperctl.figures.figure import WIDTH, legend_above, style_axes
from flipperctl.figures.render import CHASSIS, FAINT, FRONT, INK, REAR

WINDOW = 100
"""Number of episodes that a curve averages over [-]."""

DOTS = "#9DB4C0"
"""Colour of an episode's dot, visible on white and under the curves."""

Rows = Sequence[Mapping[str, str]]


def learning_figure(rows_episode: Rows, rows_validation: Rows, title: str) -> Figure:
    """Draw success, θ̂_R, return, and loss with ε over decisions, one panel above the other.

    Episode rows have the keys decision, outcome, return, pitch_variation_100hz, epsilon and loss;
    validation rows have decision, success_rate, pitch_variation_100hz and pitch_variation. An empty
    or missing cell is a gap, and so is the loss before the first update. Curves are means over the
    last 100 episodes, drawn thin where there are fewer; a dot is one episode. The panel of θ̂_R
    shows it at 100 Hz and, for validations, also at decisions, as in the paper; its curves ignore
    episodes that did not reach the finish, and validations none of whose episodes did.
    """
    figure = Figure(figsize=(WIDTH, 9.0), layout="constrained")
    success, pitch, returns, loss = figure.subplots(4, 1, sharex=True)
    at, checked = column(rows_episode, "decision"), column(rows_validation, "decision")
    reached = np.array([float(row.get("outcome") == Outcome.REACHED) for row in rows_episode])
    rate = column(rows_validation, "success_rate")
    _curve(success, at, 100 * reached, CHASSIS)
    _validation(success, checked, 100 * rate)
    success.set_ylim(-4, 104)
    swing = np.where(reached > 0, column(rows_episode, "pitch_variation_100hz"), math.nan)
    _curve(pitch, at, swing, CHASSIS, dots=True)
    at_100hz, at_decisions = (
        np.where(rate == 0, math.nan, column(rows_validation, f"pitch_variation{end}"))
        for end in ("_100hz", "")
    )
    _validation(pitch, checked, at_100hz)
    pitch.plot(
        checked, at_decisions, ":", color=FRONT, linewidth=1.2,
        marker="o", markersize=2, label="validation, at decisions",
    )  # fmt: skip
    _curve(returns, at, column(rows_episode, "return"), CHASSIS, dots=True)
    _losses(loss, at, rows_episode)
    style_axes(success, title, "", "success [%]")
    style_axes(pitch, "", "", "$\\hat\\theta_R$ where reached [rad]")
    style_axes(returns, "", "", "return [-]")
    style_axes(loss, "", "decisions", "loss [-]")
    for axes in (success, pitch, returns):
        legend_above(axes)
    if not rows_episode:
        success.text(0.5, 0.5, "no episode yet", transform=success.transAxes, ha="center")
    figure.align_ylabels()
    return figure


def column(rows: Rows, key: str) -> FloatArray:
    """Return one column as numbers, (T,), with NaN for an empty or missing cell."""
    values = []
    for i, row in enumerate(rows):
        text = row.get(key) or "nan"
        try:
            values.append(float(text))
        except ValueError as error:
            raise ValueError(f"row {i + 1}, {key}: a number is allowed; got {text!r}") from error
    return np.array(values)


def running_mean(values: FloatArray, window: int) -> FloatArray:
    """Return the means, (T,), of each value and the ``window`` - 1 before it, ignoring NaN."""
    known = np.isfinite(values)
    total = np.concatenate([[0.0], np.cumsum(np.where(known, values, 0.0))])
    count = np.concatenate([[0], np.cumsum(known)])
    end = np.arange(1, len(values) + 1)
    start = np.maximum(end - window, 0)
    weight = count[end] - count[start]
    mean = (total[end] - total[start]) / np.maximum(weight, 1)
    return np.where(weight > 0, mean, math.nan)


def _curve(axes: Axes, at: FloatArray, values: FloatArray, colour: str, dots: bool = False) -> None:
    if dots:
        size = float(np.clip(60.0 / math.sqrt(max(len(at), 1)), 1.6, 5.0))  # fewer for many [pt]
        axes.plot(
            at, values, "o", color=DOTS, markersize=size, markeredgewidth=0, rasterized=True,
            label="episode",
        )  # fmt: skip
    mean = running_mean(values, WINDOW)
    fewer = f"mean of all episodes so far, fewer than {WINDOW}"
    alone = "o" if len(at) == 1 else ""  # a line through one point is invisible
    axes.plot(
        at[:WINDOW], mean[:WINDOW], color=colour, linewidth=0.8, marker=alone, markersize=3,
        label=fewer,
    )  # fmt: skip
    if len(at) >= WINDOW:
        axes.plot(
            at[WINDOW - 1 :], mean[WINDOW - 1 :], color=colour, linewidth=1.8,
            label=f"mean of the last {WINDOW}",
        )  # fmt: skip


def _validation(axes: Axes, at: FloatArray, values: FloatArray) -> None:
    axes.plot(
        at, values, "o-", color=FRONT, markersize=5, markeredgecolor="white", linewidth=0.8,
        label="validation",
    )  # fmt: skip


def _losses(axes: Axes, at: FloatArray, rows: Rows) -> None:
    """Draw the loss on the left axis, logarithmic if any is above 0, and ε on the right axis."""
    loss = column(rows, "loss")
    axes.plot(at, loss, color=CHASSIS, linewidth=1.0, label="loss")
    if (loss > 0).any():
        axes.set_yscale("log")
        axes.tick_params(which="both", labelsize=8)
    elif len(loss):
        axes.set_yticks([])
        axes.text(0.5, 0.5, "no update yet", transform=axes.transAxes, ha="center", color=INK)
    right = axes.twinx()
    right.plot(at, column(rows, "epsilon"), color=REAR, linewidth=1.4, linestyle="--", label="ε")
    right.set_ylim(0, 1.04)
    right.set_ylabel("ε, random actions [-]", fontsize=9, color=INK)
    right.tick_params(labelsize=8, colors=INK)
    right.spines[["top", "left"]].set_visible(False)
    right.spines["right"].set_color(FAINT)
    legend_above(axes, [*axes.get_lines(), *right.get_lines()])
