"""Methods over their training seeds: scores that count failures, and their differences.

In: folders of ``eval --output``, a measure and the least price of a failed episode. Out: a
document, tables and a figure of performance profiles (Dolan and Moré 2002; Agarwal et al. 2021),
whose curves end at the success rate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from flipperctl.api import Measure
from flipperctl.config import resolver
from flipperctl.errors import RequestError
from flipperctl.evaluation.seeds import (
    PRICE,
    SeedSamples,
    better_interval,
    difference_interval,
    failure_prices,
    improvement,
    interquartile_mean,
    mean_interval,
    means,
    profile,
    resampled,
    statistic_interval,
    success_difference,
    success_interval,
    within,
)
from flipperctl.evaluation.statistics import Interval, holm
from flipperctl.evaluation.stored import Stored, read
from flipperctl.evaluation.views.summary import Document, p_text, rate_text, short
from flipperctl.messages import close_match
from flipperctl.show import Column, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALL = "all"  # name that stands for a comparison of every pair of methods
_PRICED = ("pitch_variation_100hz", "pitch_variation")
"""Measures for which ``PRICE`` is the default."""
_SEED = 0  # seed of the bootstrap
_LEVELS = 101  # number of scores at which a profile is drawn [-]
_STYLES = ("-", "--", "-.")
"""Lines of methods beside each other; with ten colours, 30 methods differ."""
_RESAMPLES = 400  # number of bootstrap samples of a band [-]
_METHODS = (
    Column("name", "method", named=True),
    Column("success_text", "success"),
    Column("score", "mean score", 3),
    Column("iqm", "IQM", 3),
    Column("reached_mean", "mean of reached", 3),
)
_GAPS = (
    Column("name", "method", named=True),
    Column("other", "against", named=True),
    Column("score", "Δ score", 3, "+"),
    Column("p_text", "p (Holm)"),
    Column("success_text", "Δ success [%] (p)"),
    Column("better", "better, episodes", 2),
)


@dataclass(frozen=True)
class Comparison:
    """Methods on the episodes that all of them played."""

    stored: Stored
    measure: str
    unit: str
    price: float
    """Least score of an episode that is not reached, in the unit of the measure."""
    against: str

    @cached_property
    def prices(self) -> dict[str, float]:
        """Score of an episode that is not reached, by scene."""
        return failure_prices(self.stored.methods, self.price)

    @property
    def label(self) -> str:
        """The measure and its unit."""
        name = "pitch variation" if self.measure == _PRICED[0] else self.measure.replace("_", " ")
        return f"{name} [{self.unit}]"


def compare(
    folders: Sequence[str],
    *,
    measure: str = _PRICED[0],
    price: float | None = None,
    against: str | None = None,
) -> Comparison:
    """Read the methods of ``DIR`` or ``METHOD=DIR``.

    ``against``: the method to compare with, by default the first; ``all`` for every pair.
    """
    found = resolver.get(Measure.kind, measure, "--measure")
    assert issubclass(found, Measure)
    if found.better != "lower":
        raise RequestError(f"--measure {measure}: a measure of which less is better is allowed")
    if price is None and measure not in _PRICED:
        raise RequestError(
            f"--price: {measure} has no default; the price of an episode that is not reached, "
            "in the measure's unit, is needed"
        )
    if price is not None and not (0 < price < math.inf):
        raise RequestError(f"--price: {price:g}; a number above 0 is allowed")
    stored = read(folders, measure)
    names = [method.name for method in stored.methods]
    if against is not None and against not in (*names, ALL):
        raise RequestError(
            f"--against: there is no method {against!r}{close_match(against, names)}; "
            f"known: {', '.join(names)}, {ALL}"
        )
    return Comparison(stored, measure, found.unit, price or PRICE, against or names[0])


def document(found: Comparison) -> Document:
    """Return the methods and their differences as plain data."""
    methods = found.stored.methods
    rows = [method_row(method, found.prices) for method in methods]
    by_name = dict(zip([method.name for method in methods], rows, strict=True))
    pairs = [
        (ours, theirs)
        for at, ours in enumerate(methods)
        for other, theirs in enumerate(methods)
        if (other < at if found.against == ALL else theirs.name == found.against and other != at)
    ]
    gaps = [difference(*pair, found.prices) for pair in pairs]
    for key in ("p", "p_success"):
        for gap, p in zip(gaps, holm([gap[key] for gap in gaps]), strict=True):
            gap[f"{key}_holm"] = p
    for (ours, _), gap in zip(pairs, gaps, strict=True):
        if found.against == ALL:
            by_name[ours.name].setdefault("comparisons", []).append(gap)
        else:
            by_name[ours.name]["comparison"] = gap
    return {
        "measure": found.measure,
        "price": found.price,
        "prices": found.prices,
        "episodes": dict(found.stored.episodes),
        "notices": list(found.stored.notices),
        "methods": rows,
    }


def method_row(method: SeedSamples, prices: Mapping[str, float]) -> Document:
    """Return the success and the scores of a method, not compared with another one.

    ``prices``: score of an episode that is not reached, by scene.
    """
    scores = method.scores(prices)
    reached = np.concatenate(
        [values[method.reached[scene]] for scene, values in method.values.items()]
    )
    rng = np.random.default_rng(_SEED)
    least = min(0.0, *(float(values.min()) for values in scores.values()))
    most = max(prices[scene] for scene in scores)

    def inside(found: Interval, most: float = most) -> Document:
        return within(found, least, most).to_dict()

    return {
        "method": method.name,
        "seeds": method.seeds,
        "trained": method.trained,
        "success": success_interval(method).to_dict(),
        "score": inside(mean_interval(scores)),
        "iqm": inside(statistic_interval(scores, interquartile_mean, rng)),
        "reached_mean": float(reached.mean()) if reached.size else None,
        "by_scene": {k: inside(mean_interval({k: v}), prices[k]) for k, v in scores.items()},
        "comparison": None,
    }


def difference(method: SeedSamples, other: SeedSamples, prices: Mapping[str, float]) -> Document:
    """Return a method minus another one, on the same episodes, without corrected p-values.

    ``improvement``: probability that a training seed has a better mean score on a scene than one of
    the other method, averaged over scenes (rliable's); ``better``: the same of single episodes.
    """
    ours, theirs = method.scores(prices), other.scores(prices)
    score, p = difference_interval(ours, theirs)
    if score.low is not None and score.low == score.high:
        score, p = Interval(score.mean, None, None), 1.0
    success, p_success = success_difference(method, other)
    return {
        "against": other.name,
        "score": score.to_dict(),
        "p": p,
        "success": success.to_dict(),
        "p_success": p_success,
        "improvement": float(improvement(-means(ours), -means(theirs))),
        "better": better_interval(ours, theirs).to_dict(),
    }


def tables(found: Document, label: str) -> Iterator[Table]:
    """Yield the table of methods and that of their differences; ``label``: of the measure."""
    episodes = ", ".join(f"{scene} {count}" for scene, count in found["episodes"].items())
    rows: list[Document] = []
    gaps: list[Document] = []
    for one in found["methods"]:
        name = short(one["method"])
        seeds = f" ({one['seeds']} seeds)" if one["seeds"] > 1 else ""
        rows.append(one | {"name": f"{name}{seeds}", "success_text": rate_text(one["success"])})
        parts = one["by_scene"].items() if len(found["episodes"]) > 1 else ()
        empty = {"success_text": "", "iqm": "", "reached_mean": "", "dim": True}
        rows += [{"name": f"  {scene}", "score": score, **empty} for scene, score in parts]
        for gap in one.get("comparisons", [one["comparison"]] if one["comparison"] else []):
            mean, p = gap["success"]["mean"], gap["p_success_holm"]
            success = "±0" if mean == 0 else f"{100 * mean:+.3g} (p {p_text(p)})"
            texts = {"p_text": p_text(gap["p_holm"]), "success_text": success}
            gaps.append(gap | {"name": name, "other": short(gap["against"]), **texts})
    rough = [f"{k} {one:.4g}" for k, one in found["prices"].items() if one > found["price"]]
    more = f", or its scene's roughest crossing: {', '.join(rough)}" if rough else ""
    notes = [f"Score: {label}; a failed episode counts {found['price']:.4g}{more}."]
    yield Table(_METHODS, rows, f"Episodes of each seed: {episodes}", notes)
    if gaps:
        yield Table(_GAPS, gaps, "Differences on the same episodes; a smaller score is better")


def seed_warnings(found: Document) -> Iterator[str]:
    """Yield lines on methods with too few training seeds."""
    trained = [one for one in found["methods"] if one["trained"]]
    if alone := [one["method"] for one in trained if one["seeds"] == 1]:
        yield (
            f"One training seed: {', '.join(alone)}. The interval is over episodes alone, and says "
            "nothing of other trainings (docs/training_seeds.md)."
        )
    if few := [one for one in trained if 1 < one["seeds"] < 5]:
        counts = ", ".join(f"{one['method']} {one['seeds']}" for one in few)
        yield (
            f"Few training seeds: {counts}; report 5 or more. One bad seed could change these "
            "numbers (docs/training_seeds.md)."
        )


def figure(found: Comparison) -> Figure:
    """Draw the profile of each method with a 95 % band of the bootstrap over seeds and episodes."""
    import matplotlib
    from matplotlib.figure import Figure

    from flipperctl.figures.figure import WIDTH, legend_above, style_axes

    methods, most = found.stored.methods, max(found.prices.values())
    never = dict.fromkeys(found.prices, math.inf)  # reached at no level
    drawn = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    axes = drawn.subplots()
    levels = np.linspace(0.0, most, _LEVELS, endpoint=False)
    colours = matplotlib.colormaps["tab10"].colors  # type: ignore[attr-defined]  # it is listed
    for index, method in enumerate(methods):
        scores = method.scores(never)
        curve = np.mean([1.0 - profile(values, levels) for values in scores.values()], axis=0)
        below = {k: (v[:, :, None] <= levels).astype(np.float64) for k, v in scores.items()}
        drawn_means = resampled(below, np.random.default_rng(0), _RESAMPLES).mean(axis=(1, 3))
        low, high = np.percentile(drawn_means, [2.5, 97.5], axis=0)  # each (L,)
        colour, style = colours[index % len(colours)], _STYLES[index % len(_STYLES)]
        name = f"{method.name}, {method.seeds} seeds" if method.seeds > 1 else method.name
        axes.step(levels, curve, style, where="post", color=colour, linewidth=1.8, label=name)
        axes.fill_between(levels, low, high, step="post", color=colour, alpha=0.15, linewidth=0)
    axes.set_xlim(0, most)
    axes.set_ylim(-0.02, 1.02)
    style_axes(axes, "", found.label, "share of episodes at or below")
    legend_above(axes)
    return drawn
