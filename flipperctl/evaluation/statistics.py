"""Means with 95 % bootstrap intervals, and the summary of a scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flipperctl.api import Outcome

RESAMPLES = 10_000
REACHED_ONLY = ("t_cost", "pitch_variation", "pitch_variation_100hz", "flipper_travel")
"""Measures that say something only of episodes that reached the finish."""
PAIRED = ("t_cost", "pitch_variation", "pitch_variation_100hz")
"""Measures that are compared draw by draw."""

Rows = Sequence[Mapping[str, Any]]


def interval(values: Sequence[float]) -> dict[str, float] | None:
    """Mean with the 2.5 and 97.5 % percentiles of the resampled mean; None without values.

    The resampling is seeded, so equal values give equal intervals (Efron 1979).
    """
    if len(values) == 0:
        return None
    array = np.asarray(values, dtype=np.float64)
    rng = np.random.default_rng(0)
    # In slices, so that 10,000 resamples of a long list stay small in memory.
    means = np.concatenate(
        [rng.choice(array, (100, len(array))).mean(axis=1) for _ in range(RESAMPLES // 100)]
    )
    low, high = np.quantile(means, (0.025, 0.975))
    return {"mean": float(array.mean()), "low": float(low), "high": float(high)}


def reached(rows: Rows) -> list[Mapping[str, Any]]:
    """The rows of episodes that reached the finish."""
    return [row for row in rows if row["outcome"] == Outcome.REACHED]


def scene_summary(terrain: str, rows: Rows) -> dict[str, Any]:
    """One entry of ``scenes`` in ``eval --json``; times [s], angles [rad].

    Where more than one kind of terrain was drawn, ``parts`` has the summary of each by its label.
    """
    summary = _summary(terrain, rows)
    if len(groups := _by_label(rows)) > 1:
        summary["parts"] = {label: _summary(label, part) for label, part in groups.items()}
    return summary


def _by_label(rows: Rows) -> dict[str, list[Mapping[str, Any]]]:
    """The rows of each kind of terrain that was drawn."""
    labels = sorted({str(row["terrain"]) for row in rows})
    return {label: [row for row in rows if row["terrain"] == label] for label in labels}


def _summary(terrain: str, rows: Rows) -> dict[str, Any]:
    good = reached(rows)
    success = interval([float(row["outcome"] == Outcome.REACHED) for row in rows])
    summary: dict[str, Any] = {
        "terrain": terrain,
        "episodes": len(rows),
        "success_rate": len(good) / len(rows),
        "success": success,
        "outcomes": {str(o): Counter(row["outcome"] for row in rows)[str(o)] for o in Outcome},
    }
    for name in REACHED_ONLY:
        summary[name] = _measure([row[name] for row in good])
    if any("crossed_by" in row for row in rows):
        # A draw that nobody is known to cross says nothing about a policy.
        fair = [row for row in rows if row["crossed_by"]]
        summary["passable"] = {
            "episodes": len(fair),
            "success_rate": len(good) / len(fair) if fair else None,
            "success": interval([float(row["outcome"] == Outcome.REACHED) for row in fair]),
        }
    summary["max_pitch"] = _measure([row["max_pitch"] for row in rows])
    summary["return"] = _measure([row["return"] for row in rows])
    return summary


def _measure(values: Sequence[float]) -> dict[str, float] | None:
    found = interval(values)
    return found and {**found, "range": float(max(values) - min(values))}


def differences(rows: Rows, others: Rows) -> dict[str, Any]:
    """``paired`` for each of the paper's measures; of a mix also ``parts``, by label."""
    found: dict[str, Any] = {name: paired(rows, others, name) for name in PAIRED}
    if len(groups := _by_label(rows)) > 1:
        found["parts"] = {
            label: {name: paired(part, others, name) for name in PAIRED}
            for label, part in groups.items()
        }
    return found


def paired(rows: Rows, others: Rows, name: str) -> dict[str, Any] | None:
    """The mean difference of a measure on equal draws where both reached the finish."""
    other = {row["seed"]: row for row in reached(others)}
    both = [(r[name], other[r["seed"]][name]) for r in reached(rows) if r["seed"] in other]
    found = interval([mine - theirs for mine, theirs in both])
    return found and {**found, "episodes": len(both)}
