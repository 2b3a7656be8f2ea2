"""``flipperctl bench``: how fast training, evaluation and decisions are on this machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import RequestError
from flipperctl.terminal.streams import print_note, show

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
    from flipperctl.commands import speed
    from flipperctl.requests.compose import compose_train, only_one
    from flipperctl.requests.text import from_words
    from flipperctl.terminal.progress import steps_progress
    from flipperctl.text.show import console, print_table

    chosen, overrides = split_arguments(words or (), tuple(speed.MEASURES))
    sizes = speed.SMALL if small else speed.Sizes()
    sizes = sizes if repeats is None else replace(sizes, repeats=repeats)
    config = only_one(compose_train(from_words(overrides)))
    header = {"machine": speed.machine(), "settings": asdict(sizes), "overrides": overrides}
    document = {**header, "measures": (measures := {})}
    with json_result(output, "bench") as write:
        for name in chosen:
            with steps_progress(name) as report:
                measures[name] = speed.MEASURES[name](config, sizes, report)
            for text in measures[name].get("missing", ()):
                print_note(f"{name}: {text}")
        write(document)

    def printed() -> None:
        for name, measured in measures.items():
            print_table(speed.table(name, measured), console())

    show(document, printed, as_json=as_json)


def split_arguments(words: Sequence[str], known: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the measures, in the order of those ``known``, and the overrides."""
    from flipperctl.text.messages import unknown

    overrides = [word for word in words if "=" in word or word.startswith("~")]
    names = [word for word in words if word not in overrides]
    allowed = ("all", *known)
    for name in names:
        if name not in allowed:
            text = unknown("there is no measure", name, allowed)
            raise RequestError(f"{text}; an override is key=value")
    every = not names or "all" in names
    return [name for name in known if every or name in names], overrides
