"""Scores of the benchmark as plain data and as a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from flipperctl.evaluation.benchmark import BenchmarkResult, Score
from flipperctl.text.messages import percent
from flipperctl.text.show import Column, Table

Document = dict[str, Any]


def document(result: BenchmarkResult, scores: Mapping[tuple[str, str], Score]) -> Document:
    """Return the scores of a method as plain data: its tracks, and the scenes of each."""
    tracks: dict[str, Any] = {}
    for (track, scene), score in scores.items():
        numbers = {"ratio": score.ratio.to_dict(), "success": score.success}
        if scene:
            tracks[track]["scenes"][scene] = {**numbers, "rule": score.rule}
        else:
            tracks[track] = {**numbers, "scenes": {}}
    seeds = sum(policy.training_seed is not None for policy in result.policies)
    return {"method": result.method, "seeds": seeds, "edition": result.edition, "tracks": tracks}


def table(methods: Sequence[Document]) -> Table:
    """Return the table of methods, best first in each track, then of their scenes."""
    tracks = dict.fromkeys(name for method in methods for name in method["tracks"])
    rows: list[dict[str, Any]] = []
    for track in tracks:
        present = [method for method in methods if track in method["tracks"]]
        present.sort(key=lambda method: float(method["tracks"][track]["ratio"]["mean"]))
        whole = [(track, method["method"], method["tracks"][track]) for method in present]
        parts = [
            (f"{track}: {name}", method["method"], method["tracks"][track]["scenes"][name])
            for name in present[0]["tracks"][track]["scenes"]
            for method in present
        ]
        rows += [
            {
                "scene": scene,
                "method": method,
                "ratio": part["ratio"],
                "success": percent(part["success"]),
                "rule": part.get("rule", ""),
            }
            for scene, method, part in (*whole, *parts)
        ]
    return Table(columns=_COLUMNS, rows=rows)


_COLUMNS = (
    Column("scene", "scene", named=True),
    Column("method", "method", named=True),
    Column("ratio", "cost / rule's", 2),
    Column("success", "success"),
    Column("rule", "rule"),
)
