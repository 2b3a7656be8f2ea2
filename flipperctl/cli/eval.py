"""``flipperctl eval``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options

HELP = """Evaluate policies on any terrain, with 95 % intervals.

A POLICY is a run, a checkpoint, an .onnx file, the folder of a sweep, a shipped policy or a
controller. Give several to compare them on the same episodes; a sweep counts as one method per
setting, with its training seeds. SETTINGS apply to the evaluation, not to the trained network;
terrain=a,b evaluates on both. A trained policy is evaluated on its own terrain by default.

conditions=… chooses physics, sensing, start and randomisation: nominal (the default), varied, wide,
or trained (those of the checkpoint). Other settings are applied on top.

Repeat a command with the same --output to play only what is missing.

[bold]Examples[/]

  flipperctl eval runs/stair/2026-01-31_12-00-00 --baseline level

  flipperctl eval best.safetensors terrain=paper_step,paper_stair --json

  flipperctl eval okada terrain=stair perception.noise=0.01 --by steps

  flipperctl eval runs/sweep okada,mpc terrain=stair,ramp --output judged

  flipperctl eval generalist suite=robustness --output judged

  flipperctl eval generalist terrain=pallet --episodes 1 --film pallet.gif

  flipperctl eval okada terrain=ramp --seed 5 --record okada.safetensors
"""


def run(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="POLICY... [SETTING...]", help="Policies; key=value, as in terrain=stair."
        ),
    ] = None,
    checkpoint: Annotated[
        list[Path] | None,
        typer.Option(metavar="RUN_OR_FILE", help="A further policy; may be repeated."),
    ] = None,
    controller: Annotated[
        str | None, typer.Option(metavar="NAMES", help="Further controllers, such as okada,mpc.")
    ] = None,
    baseline: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES", help="Controllers to compare with, such as level,okada, or none."
        ),
    ] = None,
    passable: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Also report success over the episodes that one of these can solve.",
        ),
    ] = None,
    by: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES", help="Group results by drawn numbers, such as steps,slope+up."
        ),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(metavar="NAMES", help="Further columns, such as max_pitch,return, or all."),
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
    from flipperctl.cli.plan import make_plan
    from flipperctl.config.words import with_flags
    from flipperctl.errors import RequestError
    from flipperctl.evaluation.evaluate import Result
    from flipperctl.evaluation.policies import controllers, entrants, split_policies
    from flipperctl.evaluation.run import run as evaluate
    from flipperctl.evaluation.views import evaluation, strata
    from flipperctl.evaluation.views.summary import Document
    from flipperctl.terminal.progress import EvaluationProgress
    from flipperctl.terminal.streams import print_note, show

    names, overrides = split_policies(words)
    names += [*map(str, checkpoint or ()), *([controller] if controller is not None else [])]
    if not names:
        raise RequestError("name a policy, as in: flipperctl eval generalist terrain=stair")
    flagged = with_flags(overrides, episodes=episodes, seed=seed, jobs=jobs)
    chosen = evaluation.parse_columns(columns)
    plan = make_plan(flagged, entrants(names, print_note), baseline, print_note)
    if record is not None and any(entry.config.eval.ray is not None for entry in plan.entries):
        raise RequestError("eval.ray: no meaning beside --record, which plays here; leave it out")
    references = controllers(passable, "--passable")
    groups = strata.parse(by, "--by", [entry.config for entry in plan.rows])
    progress = EvaluationProgress()

    def printed(result: Result, document: Document) -> None:
        show(document, lambda: evaluation.print_result(result, document, chosen), as_json=as_json)

    evaluate(
        plan,
        references=references,
        by=groups,
        outputs={"folder": output, "film": film, "record": record},
        show=printed,
        progress=progress,
        planned=progress.plan,
        tell=print_note,
    )
