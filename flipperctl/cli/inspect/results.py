"""``flipperctl inspect results``."""

from __future__ import annotations

from typing import Annotated

import typer

from flipperctl.cli import options

HELP = """Compare methods over their training seeds, from folders that eval --output wrote.

Failures count with a price; --detect says how many episodes show a difference.

[bold]Examples[/]

  flipperctl inspect results evaluated

  flipperctl inspect results plain=seeds/a searched=seeds/b --against plain --output profile.png

  flipperctl inspect results evaluated --detect 0.1 --detect-success 0.05
"""


def run(
    folders: Annotated[
        list[str],
        typer.Argument(
            metavar="[METHOD=]DIR...",
            help="A folder of eval --output, or a folder with one for each training seed.",
        ),
    ],
    against: Annotated[
        str | None,
        typer.Option(metavar="METHOD", help="Compare with this method, by default the first."),
    ] = None,
    measure: Annotated[
        str, typer.Option(metavar="NAME", help="The measure of the score; less is better.")
    ] = "pitch_variation_100hz",
    price: Annotated[
        float | None, typer.Option(metavar="X", help="Price of an episode not reached [6.283].")
    ] = None,
    detect: Annotated[
        float | None,
        typer.Option(metavar="D", help="Say how many episodes show this difference of the score."),
    ] = None,
    detect_success: Annotated[
        float | None,
        typer.Option(metavar="D", help="Say how many episodes show this difference of success."),
    ] = None,
    output: options.Picture = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.studies.seed_results import Question, answer
    from flipperctl.terminal.document import show
    from flipperctl.terminal.seed_table import print_notices, print_table

    found = answer(folders, Question(against, measure, price, detect, detect_success))
    print_notices(found)
    if output is not None:
        from flipperctl.report.figure import save
        from flipperctl.report.performance import profile_figure

        save(profile_figure(found.evaluated.methods, found.price, found.label), output)
    show(found.to_dict(), lambda: print_table(found, output), as_json=as_json)
