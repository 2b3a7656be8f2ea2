"""Methods pooled over their training seeds, beside the rows of their single trainings.

In: the result of an evaluation with several training seeds of a method. Out: a summary of each such
method on each scene as plain data, with intervals over seeds and episodes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Outcome
from flipperctl.evaluation.evaluate import Played, Result
from flipperctl.evaluation.rows import Row, reached
from flipperctl.evaluation.seeds import (
    Method,
    difference_interval,
    mean_interval,
    success_difference,
    success_interval,
)

_MEASURES = ("t_cost", "pitch_variation", "pitch_variation_100hz", "flipper_travel")


def key_of(scene: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return what tells a method on a scene in a document from others."""
    names = (scene.get("suite_scene", ""), scene["terrain"], scene.get("method", ""))
    return *names, scene["conditions"]["hash"], scene["seed"]


def methods(result: Result) -> list[dict[str, Any]]:
    """Return the summary of each method with several training seeds on each scene."""
    groups: dict[tuple[Any, ...], list[Played]] = {}
    for one in result.rows:
        if one.entry.training_seed is not None:
            groups.setdefault((one.entry.ground, one.entry.method), []).append(one)
    return [_pooled(result, group) for group in groups.values() if len(group) > 1]


def _pooled(result: Result, group: Sequence[Played]) -> dict[str, Any]:
    entry = group[0].entry
    table = _table(group)
    method = _method(entry.method, table)
    success = success_interval(method)
    counts = Counter(row["outcome"] for rows in table for row in rows)
    conditions = entry.conditions
    return {
        "terrain": entry.terrain,
        **{name: text for name, text in entry.names.items() if name != "training_seed"},
        "seeds": len(group),
        "episodes": len(table[0]),
        "success_rate": success.mean,
        "success": success.to_dict(),
        "outcomes": {str(outcome): counts[outcome] for outcome in Outcome},
        **{name: _measure(table, name) for name in _MEASURES},
        "seed": entry.config.eval.seed,
        "conditions": {"name": conditions.name, "hash": conditions.hash},
        "baselines": [
            {"controller": other.entry.label, "difference": _difference(group, other)}
            for other in result.baselines(group[0])
        ],
    }


def _table(group: Sequence[Played]) -> list[list[Row]]:
    """Return the episodes that all played, in the same order: a list for each of the S seeds."""
    rows = [{row["seed"]: row for row in one.episodes} for one in group]
    shared = [seed for seed in rows[0] if all(seed in other for other in rows)]
    return [[own[seed] for seed in shared] for own in rows]


def _method(name: str, table: Sequence[Sequence[Row]]) -> Method:
    good = np.array([[reached(row) for row in rows] for rows in table])
    return Method(name, {"": np.zeros(good.shape)}, {"": good})


def _crossed(table: Sequence[Sequence[Row]], name: str) -> FloatArray | None:
    """Return a measure over the episodes that every seed reached, (S, E); None without any."""
    chosen = [rows for rows in zip(*table, strict=True) if all(map(reached, rows))]
    return np.array([[row[name] for row in rows] for rows in chosen]).T if chosen else None


def _measure(table: Sequence[Sequence[Row]], name: str) -> dict[str, Any] | None:
    values = _crossed(table, name)
    return None if values is None else mean_interval({"": values}).to_dict()


def _difference(group: Sequence[Played], other: Played) -> dict[str, Any]:
    """Return the method minus a baseline on the same episodes; measures where all reached."""
    table = _table([*group, other])
    ours, theirs = _method("", table[:-1]), _method("", table[-1:])
    success, p = success_difference(ours, theirs)
    found: dict[str, Any] = {"success": success.to_dict() | {"p": p, "p_holm": p}}
    for name in _MEASURES[:3]:
        values = _crossed(table, name)
        gap = None
        if values is not None:
            gap = difference_interval({"": values[:-1]}, {"": values[-1:]})[0].to_dict()
        found[name] = gap
    return found
