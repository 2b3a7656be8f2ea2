"""Performance profiles: the fraction of episodes whose score is at most τ, for each method.

In: methods with the episodes of each training seed. Out: a matplotlib figure. A curve ends at the
success rate, since an episode that is not reached costs the price (Dolan and Moré 2002; Agarwal et
al. 2021).
"""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from flipperctl.api import FloatArray
from flipperctl.evaluation.aggregates import profile
from flipperctl.evaluation.scores import Method
from flipperctl.evaluation.seed_intervals import resampled
from flipperctl.report.figure import WIDTH, legend_above, style_axes

_LEVELS = 101
"""Number of values of τ [-]."""
_STYLES = ("-", "--", "-.")
"""Lines of methods beside each other; with ten colours, 30 methods differ."""
_RESAMPLES = 400
"""Number of bootstrap samples of a band [-]."""


def profile_figure(methods: Sequence[Method], price: float, label: str) -> Figure:
    """Draw the profile of each method with a 95 % band of the bootstrap over seeds and episodes."""
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    axes = figure.subplots()
    levels = np.linspace(0.0, price, _LEVELS, endpoint=False)
    colours = matplotlib.colormaps["tab10"].colors  # type: ignore[attr-defined]  # it is listed
    for index, method in enumerate(methods):
        curve, low, high = profile_band(method, price, levels)
        colour, style = colours[index % len(colours)], _STYLES[index % len(_STYLES)]
        name = f"{method.name}, {method.seeds} seeds" if method.seeds > 1 else method.name
        axes.step(levels, curve, style, where="post", color=colour, linewidth=1.8, label=name)
        axes.fill_between(levels, low, high, step="post", color=colour, alpha=0.15, linewidth=0)
    axes.set_xlim(0, price)
    axes.set_ylim(-0.02, 1.02)
    style_axes(axes, "", label, "reached with at most this [-]")
    legend_above(axes)
    return figure


def profile_band(
    method: Method, price: float, levels: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the profile and the ends of its band at each level, (L,), the mean over scenes."""
    scores = method.scores(price)
    curve = np.mean([1.0 - profile(values, levels) for values in scores.values()], axis=0)
    below = {k: (values[:, :, None] <= levels).astype(np.float64) for k, values in scores.items()}
    drawn = resampled(below, np.random.default_rng(0), _RESAMPLES).mean(axis=(1, 3))  # (B, L)
    low, high = np.percentile(drawn, [2.5, 97.5], axis=0)
    return curve, low, high
