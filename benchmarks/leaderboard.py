"""Tables of the benchmark's result files, for ``python -m benchmarks.tables``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from flipperctl.api import Outcome
from flipperctl.evaluation.benchmark import BenchmarkResult, find_benchmark, read_result, scores
from flipperctl.plugging import plugins
from flipperctl.text.show import Column, Table, markdown
from flipperctl.views.benchmark import document, table

_SHOWN = "generalist", "geometric", "okada", "level"
"""Methods whose pitch variation stands beside each other."""
_TRAINED = "at_d3qn", "sb3_dqn", "sb3_ppo"
"""Trainings by five seeds, beside them where costs are compared by scene."""


def results(folder: Path) -> list[BenchmarkResult]:
    """Return the result files of a folder; each is checked against its version's scenes."""
    plugins.load()
    read = {file: read_result(file) for file in sorted(folder.glob("*.json"))}
    for file, result in read.items():
        result.check(file, find_benchmark(result.benchmark))
    return list(read.values())


def leaderboard(files: Sequence[BenchmarkResult]) -> Table:
    """Return the scores of all methods, best first."""
    return table([document(r, scores(r, find_benchmark(r.benchmark))) for r in files], scenes=False)


def _name(track: str, scene: str) -> str:
    """Return the name of a scene in tables of all tracks."""
    return scene if track == "plane" else f"{scene}, {track}"


def by_scene(files: Sequence[BenchmarkResult]) -> Table:
    """Return the scores of some methods on each scene, with intervals; files have those of all."""
    shown = {*_SHOWN, *_TRAINED}
    played = {r.method: scores(r, find_benchmark(r.benchmark)) for r in files if r.method in shown}
    methods = sorted(played, key=lambda method: played[method]["plane", ""].ratio.mean)
    scenes = {at: None for of_method in played.values() for at in of_method if at[1]}
    rows = [
        {
            "scene": _name(*at),
            **{m: played[m][at].ratio.to_dict() for m in methods if at in played[m]},
        }
        for at in scenes
    ]
    return Table((Column("scene", "scene"), *(Column(m, f"`{m}`", 2) for m in methods)), rows)


def crossings(files: Sequence[BenchmarkResult]) -> Table:
    """Return the mean pitch variation of what a policy and rules reached on each scene."""
    played = {
        (r.method, scene.track, scene.scene): scene.policies[0]
        for r in files
        if r.method in _SHOWN
        for scene in r.scenes
    }
    rows = []
    for track, scene in dict.fromkeys((track, scene) for _, track, scene in played):
        row = {"ground": _name(track, scene)}
        for name in _SHOWN:
            if (part := played.get((name, track, scene))) is None:
                continue
            pairs = zip(part.outcomes, part.pitch_variation_100hz, strict=True)
            crossed = [v for outcome, v in pairs if outcome == Outcome.REACHED and v is not None]
            few = f" ({len(crossed)})" if len(crossed) < len(part.outcomes) else ""
            row[name] = f"{sum(crossed) / len(crossed):.2f}{few}" if crossed else "– (0)"
        rows.append(row)
    return Table((Column("ground", "ground"), *(Column(n, f"`{n}`") for n in _SHOWN)), rows)


TABLES: Mapping[str, Callable[[Sequence[BenchmarkResult]], Table]] = {
    "leaderboard": leaderboard,
    "scenes": by_scene,
    "crossings": crossings,
}


def lines(folder: Path, name: str) -> list[str]:
    """Return the lines of a table as Markdown."""
    return list(markdown(TABLES[name](results(folder))))
