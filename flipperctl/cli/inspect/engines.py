"""``flipperctl inspect engines``: another engine compared with the default one."""

from __future__ import annotations

from typing import Annotated

import typer

from flipperctl.cli import options

HELP = """Compare sim=mujoco, or another engine, with the default one on the same actions.

A policy drives in the default engine; the other one repeats its actions open loop on the same
ground, so that only the physics differ. Engines agree on an episode if the outcomes are equal and,
where both reach the finish, the pitches differ by at most 0.05 rad RMS at equal times and the times
by at most 3 %. Episodes that disagree are listed with the time and the position at which they
diverge. Pitches that differ at equal times but not at equal x are the same motion with a delay.

Settings of sim are those of the other engine; friction and gravity apply to both.

[bold]Examples[/]

  flipperctl inspect engines terrain=stair,plum,paper_step

  flipperctl inspect engines --checkpoint generalist terrain=ramp sim.substep=0.0025 eval.seed=7

  flipperctl inspect engines terrain=rail sim.friction=0.7 --episodes 20 --json
"""


def run(
    overrides: options.Overrides = None,
    checkpoint: options.CheckpointFile = None,
    controller: options.DefaultOkada = None,
    episodes: Annotated[
        str | None, typer.Option(metavar="N", help="Episodes per scene [10].")
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.cli.scenes import scenes
    from flipperctl.config.words import with_default, with_engine, with_flags
    from flipperctl.runs.named_policies import controller_or_okada
    from flipperctl.studies.engines import compare_scenes
    from flipperctl.terminal.document import show
    from flipperctl.terminal.engines import print_engines
    from flipperctl.terminal.progress import episodes_progress

    chosen = controller_or_okada(checkpoint, controller)
    arguments = with_default(with_flags(overrides, episodes=episodes), "eval.episodes", 10)
    asked = scenes(with_engine(arguments), checkpoint, chosen)
    found = compare_scenes(asked, episodes_progress)
    document = {"scenes": [scene.to_dict() for scene in found]}
    show(document, lambda: print_engines(found), as_json=as_json)
