"""Learning curves over methods and training seeds.

In: the rows of each run's ``metrics.csv`` as text, by method. Out: a matplotlib figure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from flipperctl.api import FloatArray, Outcome
from flipperctl.errors import RequestError
from flipperctl.figures.figure import (
    COLUMN,
    NO_PLACES,
    SUCCESS,
    VARIATION,
    Places,
    in_style,
    label,
    legend,
    look,
    note,
    panels,
    points,
)
from flipperctl.figures.figure import style_axes as style
from flipperctl.text.files import CsvRow
from flipperctl.text.messages import unknown

METRICS = (SUCCESS, VARIATION, "return")
"""Panels of a figure for which none are named."""
FEWEST_VALIDATIONS = 3
"""Number of validations from which a run's curve is drawn from them [-]."""
FEWEST_SEEDS = 5
"""Number of seeds from which a band is a 95 % interval instead of the range of the seeds [-]."""
_GRID = 201  # decisions at which curves over seeds are drawn, where they share none [-]
_RESAMPLES = 1000  # bootstrap samples of a band [-]
_TRAINED = ("loss", "epsilon", "lag", "difficulty")
"""Columns that only the rows of training episodes have."""
_REACHED_ONLY = (VARIATION, "pitch_variation_decisions", "t_cost")

Average = Literal["mean", "iqm"]
Runs = Mapping[str, Sequence[Sequence[CsvRow]]]
"""Rows of each training seed, by method."""


@dataclass(frozen=True)
class Curve:
    """One metric of a method over the decisions of its training."""

    decisions: FloatArray
    """(T,)."""
    middle: FloatArray
    """Mean or interquartile mean over seeds, (T,)."""
    low: FloatArray
    high: FloatArray
    """Ends of the band, (T,): of the seeds' range, or from five seeds on of the 95 % interval."""


def known_metrics(runs: Runs) -> list[str]:
    """Return the columns that can be drawn, since any row has a number there."""
    rows = [row for seeds in runs.values() for run_rows in seeds for row in run_rows]
    names = dict.fromkeys(name for row in rows for name in row)
    apart = ("decision", "success_rate", "decisions", "mean_return", "seconds", "seed", "episode")
    metrics = [n for n in names if n not in apart and any(map(math.isfinite, _numbers(rows, n)))]
    return [SUCCESS, *metrics]


def uses_validations(runs: Runs) -> bool:
    """Return whether curves are of validations: every run has enough of them."""
    counts = [len(_of(rows, "validation")) for seeds in runs.values() for rows in seeds]
    return min(counts) >= FEWEST_VALIDATIONS


def window(runs: Runs) -> int:
    """Return the number of training episodes that a point of a curve averages over [-]."""
    fewest = min(len(_of(rows, "episode")) for seeds in runs.values() for rows in seeds)
    return int(np.clip(fewest // 10, 10, 100))


@in_style
def curves_figure(
    runs: Runs,
    metrics: Sequence[str] = METRICS,
    *,
    average: Average = "mean",
    places: Places = NO_PLACES,
    width: float = COLUMN,
) -> Figure:
    """Draw a panel for each metric with a curve for each method, and a band over its seeds.

    Curves are of validations if every run has three or more, else of training episodes: means over
    the last 10 to 100 of them, a tenth of a run. They end where the shortest seed of the method
    does. A single run shows both. Pitch variation and time come from reached episodes; a curve
    has a gap where a seed has none. ``places``: see ``figure.places``.

    Raises:
        RequestError: a run has no row yet, or no run has a metric.
    """
    # Refuse what cannot be drawn before any drawing.
    for name, seeds in runs.items():
        if not seeds or not all(seeds):
            raise RequestError(f"{name}: there is no episode in it yet")
    known = known_metrics(runs)
    for metric in metrics:
        if metric not in known:
            raise RequestError(unknown("metric: no run has a column", metric, known))
    # A panel for each metric: the curves of all methods, or all of a single run
    figure, axes = panels(width, len(metrics), points(1.3))
    alone = len(runs) == 1 and len(next(iter(runs.values()))) == 1
    validated = uses_validations(runs)
    for panel, metric in zip(axes, metrics, strict=True):
        if alone:
            _draw_run(panel, next(iter(runs.values()))[0], metric, window(runs))
        for at, (name, seeds) in enumerate(runs.items() if not alone else ()):
            curve = over_seeds(seeds, metric, validated, window(runs), average)
            _draw(panel, curve, places.get(name, at), marked=validated and metric not in _TRAINED)
        _finish(panel, metric)
    # Decisions are named below the lowest panels, and below those that share no axis with them.
    shared = figure.axes[: len(metrics)]
    for panel in shared:
        last = panel.get_subplotspec()
        if last is not None and (last.is_last_row() or not panel.get_shared_x_axes()):
            panel.set_xlabel("Training decisions")
    legend(figure, _handles(runs, places, alone, axes, marked=validated))
    figure.align_ylabels()
    return figure


def over_seeds(
    seeds: Sequence[Sequence[CsvRow]], metric: str, validated: bool, window: int, average: Average
) -> Curve:
    """Return the curve of a method from the rows of its seeds."""
    each = [_series(rows, metric, validated, window) for rows in seeds]
    # The decisions at which any seed has a value, as far as all of them have begun and none has
    # ended
    first, last = max(at[0] for at, _ in each), min(at[-1] for at, _ in each)
    decisions = np.unique(np.concatenate([at for at, _ in each]))
    grid = decisions[(decisions >= first) & (decisions <= last)]
    if len(grid) > _GRID:
        grid = np.linspace(first, last, _GRID)
    if not len(grid):  # one seed ended before another began to be measured
        grid = np.array([last])
    table = np.array([np.interp(grid, at, values) for at, values in each])  # (S, T)
    # A single seed has no band, a few have their range, and more a bootstrap interval.
    if len(each) == 1:
        return Curve(grid, table[0], table[0], table[0])
    middle = _averaged(table, average)
    if len(each) < FEWEST_SEEDS:
        return Curve(grid, middle, table.min(axis=0), table.max(axis=0))
    drawn = np.random.default_rng(0).integers(len(table), size=(_RESAMPLES, len(table)))
    ends = np.percentile([_averaged(table[rows], average) for rows in drawn], [2.5, 97.5], axis=0)
    return Curve(grid, middle, *ends)


def running_mean(values: FloatArray, window: int) -> FloatArray:
    """Return the means, (T,), of each value and the ``window`` - 1 before it, ignoring NaN."""
    known = np.isfinite(values)
    # Cumulative sums give all windows at once; NaN adds neither to the total nor to the count.
    total = np.concatenate([[0.0], np.cumsum(np.where(known, values, 0.0))])
    count = np.concatenate([[0], np.cumsum(known)])
    end = np.arange(1, len(values) + 1)
    start = np.maximum(end - window, 0)
    weight = count[end] - count[start]
    mean = (total[end] - total[start]) / np.maximum(weight, 1)
    return np.where(weight > 0, mean, math.nan)


def column(rows: Sequence[CsvRow], key: str) -> FloatArray:
    """Return one column as numbers, (T,), with NaN for an empty or missing cell."""
    return np.array([row.number(key) if row.get(key) else math.nan for row in rows])


def _averaged(table: FloatArray, average: Average) -> FloatArray:
    """Return the mean of (S, T) values over the seeds, or the mean of their middle half, (T,)."""
    cut = len(table) // 4 if average == "iqm" else 0
    return np.asarray(np.sort(table, axis=0)[cut : len(table) - cut].mean(axis=0))


def _of(rows: Sequence[CsvRow], kind: str) -> list[CsvRow]:
    return [row for row in rows if row.get("kind", "episode") == kind]


def _numbers(rows: Sequence[CsvRow], key: str) -> list[float]:
    values = []
    for row in rows:
        try:
            values.append(float(row.get(key) or "nan"))
        except ValueError:
            values.append(math.nan)
    return values


def _series(
    rows: Sequence[CsvRow], metric: str, validated: bool, window: int
) -> tuple[FloatArray, FloatArray]:
    """Return the decisions and the values of one run's metric, (T,) each."""
    # A mean over reached episodes does not exist where no episode has reached the finish.
    if validated and metric not in _TRAINED:
        checked = _of(rows, "validation")
        at, rate = column(checked, "decision"), column(checked, "success_rate")
        if metric == SUCCESS:
            return at, 100 * rate
        # As on screens: of all episodes, without shaping
        paid = metric == "return" and all(row.get("mean_return") for row in checked)
        values = column(checked, "mean_return" if paid else metric)
        return at, np.where(rate == 0, math.nan, values) if metric in _REACHED_ONLY else values
    # Training episodes, in running means
    played = _of(rows, "episode")
    at = column(played, "decision")
    reached = np.array([row.get("outcome") == Outcome.REACHED for row in played])
    values = 100.0 * reached if metric == SUCCESS else column(played, metric)
    if metric in _REACHED_ONLY:
        values = np.where(reached, values, math.nan)
    skipped = window - 1 if len(at) > 2 * window else 0  # means of too few episodes
    return at[skipped:], running_mean(values, window)[skipped:]


def _draw(axes: Axes, curve: Curve, index: int, *, marked: bool) -> None:
    # A line through one point is invisible.
    shown = look(index, marked=marked or len(curve.decisions) == 1)
    axes.plot(curve.decisions, curve.middle, **shown)
    axes.fill_between(
        curve.decisions, curve.low, curve.high, color=shown["color"], alpha=0.18, linewidth=0
    )


def _draw_run(axes: Axes, rows: Sequence[CsvRow], metric: str, window: int) -> None:
    """Draw the training episodes and the validations of one run."""
    first, second = look(0), look(1)
    if _of(rows, "episode"):
        axes.plot(
            *_series(rows, metric, validated=False, window=window), color=first["color"],
            label=f"training, last {window} episodes",
        )  # fmt: skip
    if _of(rows, "validation") and metric not in _TRAINED:
        axes.plot(
            *_series(rows, metric, validated=True, window=window), marker="o", linestyle="--",
            color=second["color"], label="validation",
        )  # fmt: skip


def _finish(axes: Axes, metric: str) -> None:
    style(axes, label(metric), "", "")
    lines = [np.asarray(line.get_ydata(), np.float64) for line in axes.get_lines()]
    if not any(np.isfinite(line).any() for line in lines):
        note(axes, "no update yet" if metric == "loss" else "no value yet")
        return
    if metric == SUCCESS:
        axes.set_ylim(-4, 104)
    if metric == "loss":
        axes.set_yscale("log")
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.xaxis.set_major_formatter(_thousands)


def _thousands(value: float, at: float) -> str:
    """Return a number of decisions with a thin space, as units are written."""
    return f"{value:,.0f}".replace(",", "\N{THIN SPACE}")


def _handles(
    runs: Runs, places: Places, alone: bool, axes: Sequence[Axes], *, marked: bool
) -> list[Line2D]:
    """Return the entries of the legend; none for a single method."""
    if alone:
        lines = {str(line.get_label()): line for panel in axes for line in panel.get_lines()}
        return [line for name, line in lines.items() if not name.startswith("_")]
    handles = []
    for at, (name, seeds) in enumerate(runs.items()):
        text = f"{name} ({len(seeds)} seeds)" if len(seeds) > 1 else name
        handles.append(Line2D([], [], label=text, **look(places.get(name, at), marked=marked)))
    return handles
