"""``flipperctl inspect engines``: another engine against the one of the side plane."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flipperctl.cli.options import AsJson, Overrides, PluginPaths, with_default, with_flags
from flipperctl.errors import RequestError

if TYPE_CHECKING:
    from flipperctl.studies.engines import EngineComparison

HELP = """Compare sim=mujoco, or another engine, with the default one by the same actions.

A policy drives in the default engine; the other one repeats its actions open loop on the same
ground, so that only physics differs. Engines agree on an episode if the outcomes are equal and,
where both reach the finish, the pitches differ by at most 0.05 rad RMS at equal times and the times
by at most 3 %. Episodes that disagree are listed with the time and the place at which they part.
Pitches that differ at equal times but not at equal x are the same motion, a little later.

Settings of sim are those of the other engine; friction and gravity apply to both.

[bold]Examples[/]

  flipperctl inspect engines terrain=stair,plum,paper_step

  flipperctl inspect engines --checkpoint generalist terrain=ramp sim.substep=0.0025 eval.seed=7

  flipperctl inspect engines terrain=rail sim.friction=0.7 --episodes 20 --json
"""


def add_to(app: typer.Typer) -> None:
    """Register the subcommand."""
    app.command("engines", help=HELP)(show)


def show(
    overrides: Overrides = None,
    checkpoint: Annotated[
        Path | None, typer.Option(metavar="RUN_OR_FILE", help="A run, a checkpoint or an .onnx.")
    ] = None,
    controller: Annotated[
        str | None, typer.Option(metavar="NAME", help="A controller plugin [okada].")
    ] = None,
    episodes: Annotated[
        str | None, typer.Option(metavar="N", help="Episodes per scene [10].")
    ] = None,
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    if checkpoint is not None and controller is not None:
        raise RequestError("give --checkpoint or --controller, not both")
    from flipperctl import plugins as loader
    from flipperctl.cli.scenes import scenes, with_engine
    from flipperctl.studies.engines import compare_engines, in_default_engine
    from flipperctl.terminal.progress import episodes_progress

    loader.load(plugins or ())
    chosen = None if checkpoint else controller or "okada"
    arguments = with_default(with_flags(overrides, episodes=episodes), "eval.episodes", 10)
    found = []
    asked = scenes(with_engine(arguments), checkpoint, chosen)
    for config, _ in asked:
        in_default_engine(config)  # a wrong engine is found before the first episode
    for config, source in asked:
        with episodes_progress(config.terrain.plugin_name, config.eval.episodes) as report:
            found.append(compare_engines(config, source, report))
    if as_json:
        print(json.dumps({"scenes": [scene.container() for scene in found]}, indent=2))
    else:
        _print(found)


def _print(found: list[EngineComparison]) -> None:
    from flipperctl.evaluation.conditions import scene_names
    from flipperctl.terminal.conditions import condition_lines
    from flipperctl.terminal.console import console
    from flipperctl.terminal.tables import Table

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
    for line in (*conditions, *_disagreements(named)):
        out.print(line, highlight=False, markup=False, soft_wrap=True)


def _cells(scene: EngineComparison) -> list[str]:
    from flipperctl.studies.engines import mean

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
    swing = mean(e.swings[1] for e in reached), mean(e.swings[0] for e in reached)
    return [
        *counts,
        f"{mean(e.pitch_rms for e in reached):.3f} ({max(e.pitch_rms for e in reached):.3f})",
        f"{mean(e.time_ratio for e in reached):+.1%} ({slowest:+.1%})",
        f"{swing[0]:.2f} for {swing[1]:.2f} rad",
    ]


def _disagreements(named: list[tuple[str, EngineComparison]]) -> Iterator[str]:
    for name, scene in named:
        for e in scene.episodes:
            if e.agrees:
                continue
            where = ""
            if e.parts_at is not None:
                where = f"; they part at {e.parts_at[0]:.2f} s, x {e.parts_at[1]:.2f} m"
            yield (
                f"{name}, episode {e.episode} (seed {e.seed}): {e.outcomes[0]} in "
                f"{e.times[0]:.1f} s, {e.outcomes[1]} in {e.times[1]:.1f} s, pitch RMS "
                f"{e.pitch_rms:.3f} rad, {e.pitch_rms_along:.3f} rad at equal x{where}"
            )
