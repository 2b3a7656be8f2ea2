"""The output of ``flipperctl inspect engines``: a table of scenes, and disagreeing episodes."""

from __future__ import annotations

from collections.abc import Iterator

from flipperctl.evaluation.conditions import scene_names
from flipperctl.studies.engines import EngineComparison, mean
from flipperctl.terminal.conditions import condition_lines
from flipperctl.terminal.console import console, print_lines
from flipperctl.terminal.tables import Table


def print_engines(found: list[EngineComparison]) -> None:
    """Print a row for each scene, and a line for each episode on which the engines disagree."""
    first, second = found[0].engines
    title = f"{second} against {first}, the same actions of {found[0].controller}"
    headings = (
        *("terrain", "episodes", "equal outcomes", "both reached", "agree"),
        *("pitch RMS [rad] (largest)", "time (largest)", "θ̂_R"),
    )
    table = Table(headings, title)
    named = list(zip(scene_names([(s.terrain, s.conditions) for s in found]), found, strict=True))
    for name, scene in named:
        table.add(name, *_cells(scene))
    out = console()
    table.print(out)
    conditions = condition_lines((s.terrain, s.seed, s.conditions) for s in found)
    print_lines(out, (*conditions, *_disagreements(named)))


def _cells(scene: EngineComparison) -> list[str]:
    total, reached = len(scene.episodes), scene.reached
    counts = [
        str(total),
        f"{sum(e.equal_outcomes for e in scene.episodes)}/{total}",
        str(len(reached)),
        f"{sum(e.agrees for e in scene.episodes)}/{total}",
    ]
    if not reached:
        return [*counts, "–", "–", "–"]
    slowest = max((e.time_ratio for e in reached), key=abs)
    variation = mean(e.swings[1] for e in reached), mean(e.swings[0] for e in reached)
    return [
        *counts,
        f"{mean(e.pitch_rms for e in reached):.3f} ({max(e.pitch_rms for e in reached):.3f})",
        f"{mean(e.time_ratio for e in reached):+.1%} ({slowest:+.1%})",
        f"{variation[0]:.2f} for {variation[1]:.2f} rad",
    ]


def _disagreements(named: list[tuple[str, EngineComparison]]) -> Iterator[str]:
    for name, scene in named:
        for e in scene.episodes:
            if e.agrees:
                continue
            where = ""
            if e.parts_at is not None:
                where = f"; they diverge at {e.parts_at[0]:.2f} s, x {e.parts_at[1]:.2f} m"
            yield (
                f"{name}, episode {e.episode} (seed {e.seed}): {e.outcomes[0]} in "
                f"{e.times[0]:.1f} s, {e.outcomes[1]} in {e.times[1]:.1f} s, pitch RMS "
                f"{e.pitch_rms:.3f} rad, {e.pitch_rms_along:.3f} rad at equal x{where}"
            )
