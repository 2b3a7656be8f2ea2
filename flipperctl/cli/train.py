"""The commands whose overrides are a training's: ``train`` and ``bench``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, ClassVar

import typer

from flipperctl.cli import options
from flipperctl.cli.command import TrainingCommand
from flipperctl.errors import RequestError
from flipperctl.terminal.streams import print_note, show


class TrainCommand(TrainingCommand):
    """The subcommand, which passes Hydra's options on."""

    foreign_options = (
        *("-m", "--multirun", "-c", "--cfg", "-p", "--package", "--resolve", "-i", "--info"),
        *("-cd", "--config-dir", "-cn", "--config-name", "-cp", "--config-path", "--hydra-help"),
    )
    context: ClassVar = {"ignore_unknown_options": True}  # Hydra's own arrive as overrides


def train(
    overrides: options.Overrides = None,
    resume: Annotated[
        Path | None, typer.Option(metavar="RUN", help="Resume a stopped run.")
    ] = None,
    multirun: Annotated[
        bool, typer.Option("--multirun", "-m", help="One run for each combination of a,b lists.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the run, or of the runs with -m.")
    ] = None,
    cfg: Annotated[
        str | None,
        typer.Option(metavar="job|hydra|all", help="Print the composed configuration and stop."),
    ] = None,
    plugins: options.PluginPaths = None,
) -> None:
    """Train a policy. Progress goes to stderr, everything else to the run directory.

    OVERRIDES are Hydra's: key=value. [bold]flipperctl inspect config[/] shows every key.

    [bold]Examples[/]

      flipperctl train terrain=stair

      flipperctl train terrain=step seed=3 rewards.swing.weight=4

      flipperctl train -m terrain=step,stair seed=1,2 --output runs/compared

      flipperctl train --resume runs/stair/2026-01-31_12-00-00
    """
    from flipperctl.evaluation.plan import refuse_beside

    arguments = list(overrides or [])
    if resume is not None:
        refuse_beside("--resume", {"cfg": cfg, "multirun": multirun, "output": output})
        _resume(resume, arguments)
        return
    if output is not None:
        from flipperctl.config.words import key_of, literal_override

        key = "hydra.sweep.dir" if multirun else "hydra.run.dir"
        refuse_beside("--output", {word: True for word in arguments if key_of(word) == key})
        if "${" in str(output):
            raise RequestError(f"--output {output}: Hydra would replace the ${{…}}; choose another")
        arguments.append(literal_override(key, str(output)))
    if cfg is not None:
        arguments += ["--cfg", cfg]
    if multirun:
        arguments.append("--multirun")
    from flipperctl.cli.hydra.application import train

    train(arguments, check=cfg is None)


def _resume(run: Path, words: list[str]) -> None:
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.process import session
    from flipperctl.terminal.training import check_resumed, print_best, reports
    from flipperctl.training.run import check_resumable, resume

    check_resumable(words)
    changes = Overrides.parse(words).values()
    try:
        print_best(resume(run, changes, reports(), check=check_resumed))
    except KeyboardInterrupt as error:  # outside the episodes, which stop by themselves
        raise session.interrupted_run(run) from error


Small = Annotated[bool, typer.Option("--small", help="Run all in seconds, to test that it works.")]
OutputFolder = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for bench.json.")]


def bench(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MEASURE]... [OVERRIDE]...",
            help="training, evaluation, decision; and key=value.",
            show_default=False,
        ),
    ] = None,
    small: Small = False,
    repeats: Annotated[
        int | None, typer.Option(min=2, max=10_000, metavar="N", help="Rounds [10].")
    ] = None,
    output: OutputFolder = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """Measure how fast flipperctl is on this machine.

    [bold]training[/] decisions per second, updates included; [bold]evaluation[/] simulated time per
    CPU time of each engine; [bold]decision[/] of an exported policy. The table shows medians with
    quartiles. OVERRIDES are those of train.

    [bold]Examples[/]

      flipperctl bench

      flipperctl bench training decision terrain=stair network=mlp --output speed

      flipperctl bench --small --json
    """
    from flipperctl.checkpoint.results import json_result
    from flipperctl.cli import bench
    from flipperctl.cli.hydra.compose import compose_train, only_one
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.terminal.progress import steps_progress
    from flipperctl.text.show import console, print_table

    chosen, overrides = split_arguments(words or (), tuple(bench.MEASURES))
    sizes = bench.SMALL if small else bench.Sizes()
    sizes = sizes if repeats is None else replace(sizes, repeats=repeats)
    config = only_one(compose_train(Overrides.parse(overrides)))
    own = {"machine": bench.machine(), "settings": asdict(sizes), "overrides": overrides}
    document = {**own, "measures": (measures := {})}
    with json_result(output, "bench") as write:
        for name in chosen:
            with steps_progress(name) as report:
                measures[name] = bench.MEASURES[name](config, sizes, report)
            for text in measures[name].get("missing", ()):
                print_note(f"{name}: {text}")
        write(document)

    def printed() -> None:
        for name, found in measures.items():
            print_table(bench.table(name, found), console())

    show(document, printed, as_json=as_json)


def split_arguments(words: Sequence[str], known: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the measures, in the order of those ``known``, and the overrides."""
    from flipperctl.text.messages import close_match

    overrides = [word for word in words if "=" in word or word.startswith("~")]
    names = [word for word in words if word not in overrides]
    allowed = ("all", *known)
    for name in names:
        if name not in allowed:
            raise RequestError(
                f"there is no measure {name!r}{close_match(name, allowed)}; "
                f"known: {', '.join(allowed)}; an override is key=value"
            )
    every = not names or "all" in names
    return [one for one in known if every or one in names], overrides
