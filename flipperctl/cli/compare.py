"""``flipperctl compare``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options

HELP = """Compare methods over their training seeds, from folders that eval --output wrote.

A failed episode counts with a price. --against all compares every pair; --output writes the table
for LaTeX (.tex), or a picture of performance profiles (.png, .svg, .pdf).

[bold]Examples[/]

  flipperctl compare judged --against level --output profile.png

  flipperctl compare plain=a searched=b --against all --output table.tex
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
        typer.Option(metavar="METHOD", help="Compare with this method [the first], or all."),
    ] = None,
    measure: Annotated[
        str, typer.Option(metavar="NAME", help="The measure of the score; less is better.")
    ] = "pitch_variation_100hz",
    price: Annotated[
        float | None, typer.Option(metavar="X", help="Score of a failed episode [6.283].")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A table, .tex, or a picture.")
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.evaluation.views import compare as view
    from flipperctl.figures.figure import PICTURE
    from flipperctl.files import check_output, write_bytes
    from flipperctl.show import TABLE, console, latex, print_lines, print_table
    from flipperctl.terminal.streams import print_note, show

    if output is not None:
        check_output(output, TABLE if output.suffix in TABLE.suffixes else PICTURE)
    found = view.compare(folders, measure=measure, price=price, against=against)
    document = view.document(found)
    for notice in found.stored.notices:
        print_note(f"warning: {notice}")
    tables = list(view.tables(document, found.label))
    if output is not None and output.suffix in TABLE.suffixes:
        write_bytes(output, "\n".join(map(latex, tables)).encode())
    elif output is not None:
        from flipperctl.figures.figure import save

        save(view.figure(found), output)

    def printed() -> None:
        out = console()
        print_lines(out, view.price_warnings(document))
        for at, table in enumerate(tables):
            if at:
                out.print()
            print_table(table, out)
        print_lines(out, view.seed_warnings(document))

    show(document, printed, as_json=as_json)
    if output is not None:
        print_note(f"wrote {output}")
