"""Methods over their training seeds: scores that count failures, and their differences.

In: folders of ``eval --output``, a measure and the price of a failed episode. Out: a
document and tables.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flipperctl.api import Measure
from flipperctl.config import resolver
from flipperctl.env.metrics import heading
from flipperctl.errors import RequestError
from flipperctl.evaluation.names import chosen_names, taken
from flipperctl.evaluation.names import names as shown_names
from flipperctl.evaluation.seeds import (
    PRICE,
    Scores,
    SeedSamples,
    better_interval,
    difference_interval,
    improvement,
    interquartile_mean,
    means,
    score_interval,
    statistic_interval,
    success_difference,
    success_interval,
    within,
)
from flipperctl.evaluation.statistics import Interval, holm
from flipperctl.evaluation.stored import Stored, read
from flipperctl.text.messages import counted
from flipperctl.text.show import Column, Table
from flipperctl.views.summary import ROLLS, Document, p_text, rate_text

ALL = "all"  # name that stands for a comparison of every pair of methods
_PRICED = ("pitch_variation_100hz", "pitch_variation_decisions", *ROLLS)
"""Measures for which ``PRICE`` is the default."""
_INTERVALS = "Means with 95 % intervals over training seeds, of which there are n, and episodes."
_OF_ONE = "Means with 95 % intervals over episodes alone, of one training seed or a rule."
_SEED = 0  # seed of the bootstrap
_METHODS = (
    Column("name", "method", named=True),
    Column("success_text", "success"),
    Column("score", "mean score", 3),
    Column("iqm", "IQM", 3),
    Column("reached_mean", "mean where all seeds reached", 3),
)
_GAPS = (
    Column("name", "method", named=True),
    Column("other", "against", named=True),
    Column("score", "Δ score", 3, "+"),
    Column("p_text", "p"),
    Column("success_text", "Δ success [%] (p)"),
    Column("better", "better, episodes", 2),
)


@dataclass(frozen=True)
class Comparison:
    """Methods on the episodes that all of them played."""

    stored: Stored
    measure: str
    label: str
    """The measure in words and its unit."""
    price: float
    """Score of an episode that is not reached, and the largest of others, in the measure's unit."""
    against: str


def compare(
    folders: Sequence[str],
    *,
    measure: str = _PRICED[0],
    price: float | None = None,
    against: str | None = None,
    called: Sequence[str] = (),
) -> Comparison:
    """Read the methods of ``DIR`` or ``METHOD=DIR``.

    ``against``: the method to compare with, else ``usual``; ``all`` for every pair.
    ``called``: names of methods, ``NAME=METHOD``.
    """
    # A score counts failures, which needs a price in the measure's unit.
    measure_class = resolver.get(Measure.kind, measure, "--measure")
    assert issubclass(measure_class, Measure)
    if measure_class.better != "lower":
        raise RequestError(f"--measure {measure}: a measure of which less is better is allowed")
    if price is None and measure not in _PRICED:
        raise RequestError(
            f"--price: {measure} has no default; the price of an episode that is not reached, "
            "in the measure's unit, is needed"
        )
    if price is not None and not (0 < price < math.inf):
        raise RequestError(f"--price: {price:g}; a number above 0 is allowed")
    # The methods under the names that the user chose for some
    stored = read(folders, measure)
    known = [method.name for method in stored.methods]
    new_names = chosen_names(called, known)
    methods = [replace(row, name=new_names.get(row.name, row.name)) for row in stored.methods]
    stored = replace(stored, methods=tuple(methods))
    names = shown_names([method.name for method in methods])
    if against is not None and against != ALL:
        against = taken(against, names, "--against", further=[ALL])
    return Comparison(
        stored, measure, heading(measure_class), price or PRICE, against or usual(names)
    )


def usual(methods: Mapping[str, str]) -> str:
    """Return the method that others are compared with, unless a user names one."""
    return "level" if "level" in methods else next(iter(methods))


def document(comparison: Comparison) -> Document:
    """Return the methods and their differences as plain data."""
    methods = comparison.stored.methods
    rows = [method_row(method, comparison.price) for method in methods]
    by_name = dict(zip([method.name for method in methods], rows, strict=True))
    # Every pair of methods, or each against the chosen one
    pairs = [
        (method, baseline)
        for at, method in enumerate(methods)
        for other, baseline in enumerate(methods)
        if (
            other < at
            if comparison.against == ALL
            else baseline.name == comparison.against and other != at
        )
    ]
    gaps = [difference(*pair, comparison.price) for pair in pairs]
    # Tests that are shown together are corrected together.
    for key in ("p", "p_success"):
        for gap, p in zip(gaps, holm([gap[key] for gap in gaps]), strict=True):
            gap[f"{key}_holm"] = p
    for (method, _), gap in zip(pairs, gaps, strict=True):
        if comparison.against == ALL:
            by_name[method.name].setdefault("comparisons", []).append(gap)
        else:
            by_name[method.name]["comparison"] = gap
    return {
        "measure": comparison.measure,
        "price": comparison.price,
        "episodes": dict(comparison.stored.episodes),
        "notices": list(comparison.stored.notices),
        "methods": rows,
    }


def method_row(method: SeedSamples, price: float) -> Document:
    """Return the success and the scores of a method, not compared with another one.

    ``price``: score of an episode that is not reached.
    """
    scores = method.scores(price)
    crossed = {k: float(v.mean()) if v.size else None for k, v in method.crossings().items()}
    means = [mean for mean in crossed.values() if mean is not None]
    rng = np.random.default_rng(_SEED)

    def middle(values: Scores) -> Interval:
        return statistic_interval(values, interquartile_mean, rng)

    # No score lies outside the least value and the price, so that no interval should either.
    least = min(0.0, *(float(values.min()) for values in scores.values()))

    def inside(interval: Interval) -> Document:
        return within(interval, least, price).to_dict()

    return {
        "method": method.name,
        "seeds": method.seeds,
        "trained": method.trained,
        "success": success_interval(method).to_dict(),
        "score": inside(score_interval(method, price)),
        "iqm": inside(score_interval(method, price, middle)),
        "reached_mean": float(np.mean(means)) if len(means) == len(crossed) else None,
        "reached_by_scene": crossed,
        "by_scene": {k: inside(score_interval(method.on(k), price)) for k in scores},
        "comparison": None,
    }


def difference(method: SeedSamples, other: SeedSamples, price: float) -> Document:
    """Return a method minus another one, on the same episodes, without corrected p-values.

    ``improvement``: probability that a training seed has a better mean score on a scene than one of
    the other method, averaged over scenes (rliable's); ``better``: the same of single episodes.
    """
    scores, baseline = method.scores(price), other.scores(price)
    score, p = difference_interval(scores, baseline)
    if score.low is not None and score.low == score.high:
        score, p = Interval(score.mean, None, None), 1.0
    success, p_success = success_difference(method, other)
    return {
        "against": other.name,
        "score": score.to_dict(),
        "p": p,
        "success": success.to_dict(),
        "p_success": p_success,
        "improvement": float(improvement(-means(scores), -means(baseline))),
        "better": better_interval(scores, baseline).to_dict(),
    }


def tables(compared: Document, label: str) -> Iterator[Table]:
    """Yield the tables of methods and of their differences; ``label``: the measure's."""
    episodes = ", ".join(f"{scene} {count}" for scene, count in compared["episodes"].items())
    rows: list[Document] = []
    gaps: list[Document] = []
    called = shown_names([method["method"] for method in compared["methods"]])
    # A row for each method, its scenes below it; differences are a table of their own.
    for method in compared["methods"]:
        name = called[method["method"]]
        seeds = f" ({method['seeds']} seeds)" if method["seeds"] > 1 else ""
        rows.append(
            method | {"name": f"{name}{seeds}", "success_text": rate_text(method["success"])}
        )
        parts = method["by_scene"].items() if len(compared["episodes"]) > 1 else ()
        empty = {"success_text": "", "iqm": "", "dim": True}
        reached = method["reached_by_scene"]
        rows += [
            {"name": f"  {scene}", "score": score, "reached_mean": reached[scene], **empty}
            for scene, score in parts
        ]
        for gap in method.get(
            "comparisons", [method["comparison"]] if method["comparison"] else []
        ):
            mean, p = gap["success"]["mean"], gap["p_success_holm"]
            success = "±0" if mean == 0 else f"{100 * mean:+.3g} (p {p_text(p)})"
            texts = {"p_text": p_text(gap["p_holm"]), "success_text": success}
            gaps.append(gap | {"name": name, "other": called[gap["against"]], **texts})
    price = f"{compared['price']:.4g}"
    notes = [
        f"Score: {label}; a failed episode counts {price}, and a crossing at most that. Its "
        "95 % interval allows for failures that so few episodes need not show."
    ]
    differs = _iqm_differs(compared["methods"])
    columns = [column for column in _METHODS if differs or column.key != "iqm"]
    yield Table(columns, rows, f"Episodes of each seed: {episodes}", notes)
    if gaps:
        title = "Differences on the same episodes; a smaller score is better"
        note = f"p: Holm's correction for {counted(len(gaps), 'difference')}."
        yield Table(_GAPS, gaps, title, [note])


def _iqm_differs(methods: Sequence[Document]) -> bool:
    """Return whether any interquartile mean is not the mean, as it is of fewer than four scores."""
    return any(method["iqm"]["mean"] != method["score"]["mean"] for method in methods)


def paper_table(compared: Document, label: str) -> Table:
    """Return the table of methods for a paper, pooled over training seeds.

    Its last column is the difference to the method that all are compared with, or else the
    interquartile mean, if that is not the score. ``label``: of the measure.
    """
    methods = compared["methods"]
    called = shown_names([method["method"] for method in methods])
    unit = label[label.rindex("[") :]
    rows: list[Document] = []
    # A row for each method, its scenes below it
    for method in methods:
        success = rate_text(method["success"]).replace(" %", "")
        gap = (method["comparison"] or {}).get("score")
        parts = method["by_scene"].items() if len(compared["episodes"]) > 1 else ()
        texts = {"name": called[method["method"]], "success": success, "gap": gap or ""}
        rows.append(method | texts | {"line": bool(parts)})
        empty = {"seeds": "", "success": "", "gap": "", "iqm": ""}
        rows += [{"name": f"  {scene}", "score": score, **empty} for scene, score in parts]
    # The last column is the difference, if all are compared with the same method.
    against = {method["comparison"]["against"] for method in methods if method["comparison"]}
    last = [Column("iqm", f"IQM {unit}")] if _iqm_differs(methods) else []
    if len(against) == 1:
        (other,) = against
        last = [Column("gap", f"Δ to {called[other]} {unit}")]
    columns = (
        Column("name", "method", named=True),
        Column("seeds", "seeds", latex="$n$"),
        Column("success", "success [%]"),
        Column("score", f"score {unit}"),
        *last,
    )
    (methods_table, *_) = tables(compared, label)
    single = all(method["seeds"] == 1 for method in methods)
    notes = [*methods_table.notes, _OF_ONE if single else _INTERVALS]
    return Table(columns, rows, methods_table.title, notes)


def seed_warnings(compared: Document) -> Iterator[str]:
    """Yield lines on methods with too few training seeds."""
    called = shown_names([method["method"] for method in compared["methods"]])
    trained = [method for method in compared["methods"] if method["trained"]]
    if alone := [called[method["method"]] for method in trained if method["seeds"] == 1]:
        yield (
            f"One training seed: {', '.join(alone)}. The interval is over episodes alone, and says "
            "nothing of other trainings (docs/comparing.md)."
        )
    if few := [method for method in trained if 1 < method["seeds"] < 5]:
        counts = ", ".join(f"{called[method['method']]} {method['seeds']}" for method in few)
        yield (
            f"Few training seeds: {counts}; report 5 or more. One bad seed could change these "
            "numbers (docs/comparing.md)."
        )
