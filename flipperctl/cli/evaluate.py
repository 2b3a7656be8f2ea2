"""The commands that play episodes or read them: ``eval``, ``map``, ``replay`` and ``compare``."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import FlipperctlError, InterruptedRunError, RequestError
from flipperctl.terminal.streams import print_note, show


def evaluate(
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
            metavar="NAMES",
            help="Controllers to compare with, or none. Several policies have level,geometric, one "
            "alone has none, a planner its own.",
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
        typer.Option(metavar="FILE", help="Film of the first episode: .gif or .mp4."),
    ] = None,
    episode: Annotated[
        str | None, typer.Option(metavar="N", help="Episodes of the film, as in 7 or 3,7 [0].")
    ] = None,
    failures: Annotated[
        bool, typer.Option("--failures", help="Film the first failed episodes instead.")
    ] = False,
    speed: Annotated[
        float | None, typer.Option(metavar="X", help="Times real time of the film [3].")
    ] = None,
    record: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Recorded episodes, to teach a training.")
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """Evaluate policies on any terrain, with 95 % intervals.

    A POLICY is a run, a checkpoint, an .onnx file, the folder of a sweep, a shipped policy, a
    controller or a file of tune. Give several to compare them on the same episodes; a sweep counts
    as one method per setting, with its training seeds. SETTINGS apply to the evaluation, not to the
    trained network; terrain=a,b evaluates on both. A trained policy is evaluated on its own terrain
    by default.

    conditions=… chooses physics, sensing, start and randomisation: nominal (the default), trained
    (those of the checkpoint), or one of flipperctl list conditions. Other settings apply on top.

    Repeat a command with the same --output to play only what is missing.

    [bold]Examples[/]

      flipperctl eval runs/stair/2026-01-31_12-00-00 --baseline level

      flipperctl eval best.safetensors terrain=paper_step,paper_stair --json

      flipperctl eval okada terrain=stair perception.noise=0.01 --by steps

      flipperctl eval runs/sweep okada,mpc terrain=stair,ramp --output judged

      flipperctl eval generalist suite=robustness --output judged

      flipperctl eval generalist level terrain=step --episodes 1 --film a.gif

      flipperctl eval okada terrain=ramp --seed 5 --record okada.safetensors
    """
    from flipperctl.config.words import with_flags
    from flipperctl.evaluation.evaluate import Result
    from flipperctl.evaluation.plan import controllers, entrants, split_policies
    from flipperctl.requests.evaluation import run
    from flipperctl.requests.filming import Filming
    from flipperctl.requests.plan import make_plan
    from flipperctl.requests.text import from_words
    from flipperctl.terminal.progress import EvaluationProgress
    from flipperctl.views import evaluation
    from flipperctl.views.summary import Document

    names, overrides = split_policies(words)
    names += [*map(str, checkpoint or ()), *([controller] if controller is not None else [])]
    if not names:
        raise RequestError("name a policy, as in: flipperctl eval generalist terrain=stair")
    flagged = with_flags(overrides, episodes=episodes, seed=seed, jobs=jobs)
    shown_columns = evaluation.parse_columns(columns)
    policies, returns = entrants(names, print_note), as_json or "return" in shown_columns
    plan = make_plan(from_words(flagged), policies, baseline, print_note, returns=returns)
    if record is not None and any(entry.config.eval.ray is not None for entry in plan.entries):
        raise RequestError("eval.ray: no meaning beside --record, which plays here; leave it out")

    # What the results are compared with and grouped by
    sources = [entry.source for entry in plan.entries]
    references = controllers(passable, "--passable", planned=sources)
    groups = evaluation.parse_groups(by, "--by", [entry.config for entry in plan.rows])
    progress = EvaluationProgress()

    def printed(result: Result, document: Document) -> None:
        show(
            document,
            lambda: evaluation.print_result(result, document, shown_columns),
            as_json=as_json,
        )

    run(
        plan,
        references=references,
        by=groups,
        outputs={"folder": output, "record": record},
        filming=Filming.asked(film, episode, failures, speed),
        show=printed,
        progress=progress,
        planned=progress.plan,
        tell=print_note,
        typed=shlex.join(["flipperctl", *sys.argv[1:]]),
    )


def map_success(
    words: Annotated[
        list[str] | None, typer.Argument(metavar="POLICY [SETTING...]", help="A policy; key=value.")
    ] = None,
    over: Annotated[
        str | None,
        typer.Option(metavar="SETTINGS", help="Two settings, such as terrain.height,sim.friction."),
    ] = None,
    episodes: Annotated[
        str | None, typer.Option(metavar="N", help="Episodes at each point [10].")
    ] = None,
    seed: options.Seed = None,
    jobs: options.Jobs = None,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the map and its picture.")
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """Map where a policy succeeds, over two settings.

    A coarse grid is played first, and then the points where success changes. --over names two
    settings with their ranges, LOW:HIGH or LOW:HIGH:VALUES; + joins settings with one common value.
    Repeat a command with the same --output to play only what is missing.

    [bold]Examples[/]

      flipperctl map okada terrain=uplift --over terrain.height,sim.friction

      flipperctl map generalist --over terrain.height=0.1:0.6:8,sim.friction
    """
    from flipperctl.cli.plan import one_scene, player
    from flipperctl.config.words import with_default, with_flags
    from flipperctl.evaluation.map import EPISODES, EXAMPLE, capability_map, notes, parse_axes
    from flipperctl.text.show import console, print_lines
    from flipperctl.views import map as view

    if over is None:
        raise RequestError(f"name two settings, as in --over {EXAMPLE}")
    flagged = with_flags(words, episodes=episodes, seed=seed, jobs=jobs)
    flagged = with_default(flagged, "eval.episodes", EPISODES)
    entry = one_scene(flagged, "map")
    if entry.config.eval.ray is not None:
        raise RequestError("eval.ray: a map is played here; leave it out")

    # The points, and what is said of them before they are played
    axes = parse_axes(over, entry.config)
    with player(output, "map", view.NAMES) as (plays, folder):
        for note in notes(entry, axes):
            print_note(note)
        success_map = capability_map(entry, axes, plays)
        try:
            show(
                success_map.to_dict(),
                lambda: print_lines(console(), view.lines(success_map)),
                as_json=as_json,
            )
        finally:  # files are written even if the pipe is closed
            if folder is not None:
                folder.replace(lambda part: view.write(part, success_map))
                print_note(f"saved to {folder.path}")
        if success_map.interrupted:
            raise InterruptedRunError(f"interrupted: {success_map.played} points are finished")


def replay(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A recorded failure or drive, or a folder: its first."),
    ],
    checkpoint: Annotated[
        Path | None, typer.Option(metavar="RUN_OR_FILE", help="The policy, if it has moved since.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for replay.json and replay.png.")
    ] = None,
    film: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Film of it: .gif or .mp4.")
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """Play a recorded failure or drive once more, and check that it is the same bit for bit.

    eval --output and map --output record failures as failure_….json.

    [bold]Examples[/]

      flipperctl replay evaluated/failure_stair_3.json --film stair.gif
    """
    from flipperctl.requests.replay import lines, replay_file
    from flipperctl.terminal.progress import episodes_progress
    from flipperctl.text.messages import counted
    from flipperctl.text.show import console, print_lines

    if file.is_dir():
        failures = sorted(file.glob("failure_*.json"))
        if not failures:
            raise RequestError(f"{file}: the folder has no failure_….json; all was reached there")
        print_note(f"the first of {counted(len(failures), 'failure')}: {failures[0].name}")
        file = failures[0]
    replayed = replay_file(
        file, checkpoint, output, film, progress=episodes_progress, tell=print_note
    )
    show(replayed.to_dict(), lambda: print_lines(console(), lines(replayed)), as_json=as_json)
    if replayed.differences:
        raise FlipperctlError(
            f"{file}: the episode differs from the recorded one: {'; '.join(replayed.differences)}"
        )


def compare(
    folders: Annotated[
        list[str],
        typer.Argument(
            metavar="[METHOD=]DIR...",
            help="A folder of eval --output, or a folder with one for each training seed.",
        ),
    ],
    against: Annotated[
        str | None,
        typer.Option(
            metavar="METHOD", help="Method to compare with, else level, else the first; or all."
        ),
    ] = None,
    measure: Annotated[
        str, typer.Option(metavar="NAME", help="The measure of the score; less is better.")
    ] = "pitch_variation_100hz",
    price: Annotated[
        float | None, typer.Option(metavar="X", help="Score of a failed episode [6.283].")
    ] = None,
    name: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=METHOD", help="Name of a method; may be repeated."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE.tex", help="The table of methods for LaTeX.")
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """Compare methods over their training seeds, from folders that eval --output wrote.

    A failed episode counts --price, and a crossing at most that, whatever the other methods do.
    Compare every pair with --against all, and write the table for LaTeX with --output. Figures of
    the same folders are drawn by flipperctl plot.

    [bold]Examples[/]

      flipperctl compare judged --against level --name AT-D3QN=at_d3qn

      flipperctl compare plain=a searched=b --against plain --output table.tex
    """
    from flipperctl.text.files import check_output, write_bytes
    from flipperctl.text.show import TABLE, console, latex, print_lines, print_table
    from flipperctl.views import compare as view

    if output is not None:
        check_output(output, TABLE)

    # Scores of methods, and what was left out of them
    comparison = view.compare(
        folders, measure=measure, price=price, against=against, called=name or ()
    )
    document = view.document(comparison)
    for notice in comparison.stored.notices:
        print_note(f"warning: {notice}")
    tables = list(view.tables(document, comparison.label))
    if output is not None:
        write_bytes(output, latex(view.paper_table(document, comparison.label)).encode())

    # The same tables on the terminal
    def printed() -> None:
        out = console()
        for at, table in enumerate(tables):
            if at:
                out.print()
            print_table(table, out)
        print_lines(out, view.seed_warnings(document))

    show(document, printed, as_json=as_json)
    if output is not None:
        print_note(f"wrote {output}")
