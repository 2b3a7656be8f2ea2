"""Tables of the benchmark's result files, for ``python -m benchmarks.tables``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from flipperctl.api import Outcome
from flipperctl.evaluation.benchmark import BenchmarkResult, find_benchmark, read_result, scores
from flipperctl.plugging import plugins
from flipperctl.text.show import Column, Table, markdown
from flipperctl.views.benchmark import document

_SHOWN = "generalist", "geometric", "okada", "level"
"""Methods that are compared by scene; the costs of the first have intervals."""
_TELLING = {
    "plane": (
        *("step", "uplift", "gap", "plum", "stairwell", "natural ground, class G"),
        *("damaged stairs at friction 0.6", "absolem, building stair", "all kinds, wide"),
    ),
    "3-D": ("pallet",),
}
"""Scenes whose pitch variation is shown, by track: where the policy does well, and where not."""


def results(folder: Path) -> list[BenchmarkResult]:
    """Return the result files of a folder; each is checked against its version's scenes."""
    plugins.load()
    read = {file: read_result(file) for file in sorted(folder.glob("*.json"))}
    for file, result in read.items():
        result.check(file, find_benchmark(result.benchmark))
    return list(read.values())


def leaderboard(files: Sequence[BenchmarkResult]) -> Table:
    """Return the scores of all methods for pairs, best in the plane first."""
    return _board(files, [*_TELLING])


def four(files: Sequence[BenchmarkResult]) -> Table:
    """Return the scores of all methods for four flippers, best first."""
    return _board(files, ["four"])


def _board(files: Sequence[BenchmarkResult], tracks: Sequence[str]) -> Table:
    """Return the scores of the methods that played the first of some tracks, best in it first."""
    methods = [document(r, scores(r, find_benchmark(r.benchmark))) for r in files]
    methods = [method for method in methods if tracks[0] in method["tracks"]]
    methods.sort(key=lambda method: float(method["tracks"][tracks[0]]["ratio"]["mean"]))
    rows = [
        {"method": f"`{method['method']}`"}
        | {track: part["ratio"] for track, part in method["tracks"].items()}
        | {f"{t} success": f"{100 * p['success']:.3g} %" for t, p in method["tracks"].items()}
        for method in methods
    ]
    columns = [Column("method", "method")]
    for track in tracks:
        columns += [Column(track, track, 2), Column(f"{track} success", "success")]
    return Table(columns, rows)


def _name(track: str, scene: str) -> str:
    """Return the name of a scene in tables of all tracks."""
    return scene if track == "plane" else f"{scene}, {track}"


def by_scene(files: Sequence[BenchmarkResult]) -> Table:
    """Return the costs of some methods on each scene; the files have those of all."""
    played = {r.method: scores(r, find_benchmark(r.benchmark)) for r in files if r.method in _SHOWN}
    first, *others = [method for method in _SHOWN if method in played]
    rows = [
        {
            "scene": _name(*at),
            first: score.ratio.to_dict(),
            **{m: played[m][at].ratio.mean for m in others if at in played[m]},
        }
        for at, score in played[first].items()
        if at[1]
    ]
    return Table((Column("scene", "scene"), *(Column(m, f"`{m}`", 2) for m in _SHOWN)), rows)


def crossings(files: Sequence[BenchmarkResult]) -> Table:
    """Return the mean pitch variation of what a policy and rules reached on telling scenes."""
    played = {
        (r.method, scene.track, scene.scene): scene.policies[0]
        for r in files
        if r.method in _SHOWN
        for scene in r.scenes
        if scene.scene in _TELLING.get(scene.track, ())
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
    "four": four,
    "scenes": by_scene,
    "crossings": crossings,
}


def lines(folder: Path, name: str) -> list[str]:
    """Return the lines of a table as Markdown."""
    return list(markdown(TABLES[name](results(folder))))
