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

  flipperctl eval --controller okada terrain=uplift --map terrain.height,sim.friction=0.4:1.0

  flipperctl eval --replay evaluated/failure_stair_3.json --film stair.gif

Several policies stand in one table, on the same episodes; the folder of a sweep stands for its
training seeds. The same words with the same --output play only what is not there yet.

  flipperctl eval --checkpoint runs/sweep --controller okada,mpc terrain=stair,ramp --output judged

  flipperctl eval suite=robustness --controller okada --output judged
"""


def run(
    overrides: options.Overrides = None,
    checkpoint: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="RUN_OR_FILE",
            help="A run, a checkpoint, an .onnx file or the folder of a sweep; may be repeated.",
        ),
    ] = None,
    controller: Annotated[
        str | None,
        typer.Option(metavar="NAMES", help="Controller plugins, such as okada or okada,mpc."),
    ] = None,
    baseline: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Controllers, such as okada,level, to compare with on the same episodes "
            "(mpc and planner: okada,level unless named here; several policies: level,okada as "
            "further rows; none: no comparison).",
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
    axes: Annotated[
        str | None,
        typer.Option(
            "--map",
            metavar="SETTINGS",
            help="Map of success over two settings: terrain.height=0.1:0.6,sim.friction=0.4:1.0.",
        ),
    ] = None,
    replay: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Play a recorded failure (failure_….json) once more."),
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.cli import several
    from flipperctl.cli.eval_map import run_map
    from flipperctl.cli.eval_replay import run_replay
    from flipperctl.cli.scenes import scenes
    from flipperctl.config.words import with_flags
    from flipperctl.errors import RequestError
    from flipperctl.evaluation.groups import grouped, parse
    from flipperctl.evaluation.scenes import evaluate
    from flipperctl.runs.evaluation import EvaluationFiles
    from flipperctl.runs.interrupts import interrupts
    from flipperctl.runs.methods import entrants
    from flipperctl.runs.named_policies import controllers, only, require_policy
    from flipperctl.runs.suites import split_suite
    from flipperctl.terminal.progress import episodes_progress
    from flipperctl.terminal.results import print_result
    from flipperctl.terminal.streams import print_note

    others: dict[str, object] = {
        "baseline": baseline,
        "passable": passable,
        "by": by,
        "record": record,
    }
    files = checkpoint or []
    if replay is not None:
        others |= {"controller": controller, "map": axes, "episodes": episodes, "seed": seed}
        others |= {"jobs": jobs, "overrides": overrides}
        run_replay(replay, only(files, "--replay"), output, film, as_json=as_json, others=others)
        return
    require_policy(files, controller, overrides)
    flagged = with_flags(overrides, episodes=episodes, seed=seed, jobs=jobs)
    suite, arguments = split_suite(flagged)
    if axes is not None:
        others |= {"film": film, "suite=…": suite}
        checkpoint_of_map = only(files, "--map", controller)
        run_map(
            *(axes, flagged, checkpoint_of_map, controller, output), as_json=as_json, others=others
        )
        return
    outputs = {"folder": output, "film": film, "record": record}
    policies = entrants(files, controller, print_note)
    if suite or len(policies) > 1:
        several.run(
            *(arguments, policies, suite, baseline, passable, by),
            outputs=outputs,
            as_json=as_json,
        )
        return
    (policy,) = policies
    found = scenes(arguments, policy.run, None if policy.run else policy.method)
    if record is not None and any(config.eval.ray is not None for config, _ in found):
        raise RequestError("eval.ray: no meaning beside --record, which plays here; leave it out")
    against = controllers(baseline, "--baseline", found[0][1].baselines())
    references = controllers(passable, "--passable")
    groups = parse(by, "--by", [config for config, _ in found])
    with ExitStack() as stack:
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
        typed = str(policy.run) if policy.run and policy.run.is_dir() else result.controller
        try:
            print_result(result, None if as_json else typed)
        finally:  # files are written even if the pipe is closed
            written.write(result)
        written.draw(result, stop, episodes_progress)
