"""``flipperctl eval``."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options

HELP = """Evaluate a checkpoint or a controller on any terrain, with 95 % intervals.

OVERRIDES apply to the evaluation, not to the trained network; terrain=a,b evaluates on both.
A checkpoint, or an exported .onnx file, which runs as on the robot, is evaluated on its training
terrain unless terrain=… names another.

conditions=… chooses physics, sensing, start and randomisation: nominal (the default, for policies
and rules alike), varied, wide, or trained (those of the checkpoint). Overrides are applied on top.

[bold]Examples[/]

  flipperctl eval --checkpoint runs/stair/2026-01-31_12-00-00 --episodes 100

  flipperctl eval --checkpoint best.safetensors terrain=paper_step,paper_stair --json

  flipperctl eval --controller okada terrain=stair perception.noise=0.01 --by steps --jobs 2

  flipperctl eval --checkpoint runs/stair/2026-01-31_12-00-00 --baseline okada conditions=trained

  flipperctl eval --checkpoint generalist terrain=pallet --episodes 1 --film pallet.gif

  flipperctl eval --controller okada terrain=ramp --seed 5 --record okada.safetensors
"""


def run(
    overrides: options.Overrides = None,
    checkpoint: options.CheckpointFile = None,
    controller: options.ControllerName = None,
    baseline: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Controllers, such as okada,level, to compare with on the same episodes "
            "(mpc and planner: okada,level unless named here; none: no comparison).",
        ),
    ] = None,
    passable: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="References, such as okada,level,planner: each plays the episodes that no "
            "earlier one crossed; success is also reported over the episodes that any of them "
            "crosses.",
        ),
    ] = None,
    by: Annotated[
        str | None,
        typer.Option(metavar="NAMES", help="Show results by drawn numbers too: steps,slope+up."),
    ] = None,
    episodes: options.Episodes = None,
    seed: options.Seed = None,
    jobs: options.Jobs = None,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for results, tables and pictures.")
    ] = None,
    film: Annotated[
        Path | None,
        typer.Option(metavar="FILE.gif", help="Film of the first episode of the only scene."),
    ] = None,
    record: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Recorded episodes, to teach a training.")
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.cli.scenes import scenes
    from flipperctl.config.words import with_flags
    from flipperctl.evaluation.groups import grouped, parse
    from flipperctl.evaluation.scenes import evaluate
    from flipperctl.runs.evaluation import EvaluationFiles
    from flipperctl.runs.interrupts import interrupts
    from flipperctl.runs.named_policies import controllers, require_one_policy
    from flipperctl.terminal.progress import episodes_progress
    from flipperctl.terminal.results import print_result
    from flipperctl.terminal.streams import print_note

    require_one_policy(checkpoint, controller, overrides)
    arguments = with_flags(overrides, episodes=episodes, seed=seed, jobs=jobs)
    found = scenes(arguments, checkpoint, controller)
    against = controllers(baseline, "--baseline", found[0][1].baselines())
    references = controllers(passable, "--passable")
    groups = parse(by, "--by", [config for config, _ in found])
    with ExitStack() as stack:
        outputs = {"folder": output, "film": film, "record": record}
        written = EvaluationFiles(found, stack, **outputs, tell=print_note)
        stop = stack.enter_context(interrupts("finishing the episode; Ctrl-C again stops at once"))
        result = evaluate(
            found,
            baselines=against,
            references=references,
            progress=episodes_progress,
            record=record is not None,
            stop=stop,
            store=written.store,
        )
        result = grouped(result, groups)
        # The table shows a run as it was typed; files and JSON show its checkpoint.
        typed = str(checkpoint) if checkpoint and checkpoint.is_dir() else result.controller
        try:
            print_result(result, None if as_json else typed)
        finally:  # files are written even if the pipe is closed
            written.write(result)
        written.draw(result, stop, episodes_progress)
