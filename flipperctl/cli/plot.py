"""``flipperctl plot``: figures of runs, sweeps, results and maps, for papers and slides."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import RequestError
from flipperctl.requests.drawing import KINDS
from flipperctl.terminal.streams import print_note


def plot(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="[NAME=]PATH...", help="Runs, a sweep, folders of eval or map --output."
        ),
    ],
    kind: Annotated[
        str | None, typer.Option(metavar="KIND", help=f"One of {', '.join(KINDS)}.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A picture: .pdf, .svg or .png [KIND.pdf]."),
    ] = None,
    name: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=METHOD", help="Name of a method; may be repeated."),
    ] = None,
    metric: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES", help="Metrics, such as success,return,pitch_variation_100hz."
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="METHOD", help="Draw only this method; may be repeated."),
    ] = None,
    scene: Annotated[
        str | None, typer.Option(metavar="NAME", help="Scene of series and poses, else the first.")
    ] = None,
    episode: Annotated[
        int | None,
        typer.Option(metavar="N", help="Episode of series and poses, else a telling one."),
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(metavar="METHOD", help="Method of differences, else level, else the first."),
    ] = None,
    average: Annotated[
        str, typer.Option(metavar="NAME", help="Average over seeds in curves: mean or iqm.")
    ] = "mean",
    width: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help="Width of the figure, as in 3.5in or 18cm [3.5in; poses: 7.16in; slides: 10in].",
        ),
    ] = None,
    style: Annotated[
        str, typer.Option(metavar="NAME", help="Size of the text: paper or slides.")
    ] = "paper",
    plugins: options.PluginPaths = None,
) -> None:
    """Draw a figure for a paper or a slide.

    Runs and sweeps give learning curves over methods and seeds. Folders of eval --output give
    intervals, a heat table (heat), paired differences, performance profiles, or one episode as
    time series or as poses along the ground. Folders of map --output give maps. Without --kind, the
    first of these is drawn.

    Text has its right size at the width of the figure: 3.5in is one column of a two-column page,
    7.16in are both. Command, paths and hashes stand in the file's metadata.

    [bold]Examples[/]

      flipperctl plot runs/sweep --output curves.pdf

      flipperctl plot AT-D3QN=runs/first MLP=runs/second --metric success,return

      flipperctl plot judged --name AT-D3QN=at_d3qn --width 7.16in

      flipperctl plot judged --kind differences --style slides --output gain.svg

      flipperctl plot judged --kind series --only at_d3qn --only level
    """
    from flipperctl.figures.figure import PICTURE, save
    from flipperctl.requests.drawing import draw, kind_of, length
    from flipperctl.text.files import check_output
    from flipperctl.views.plot import Request

    if output is not None:
        check_output(output, PICTURE)
    path = output or Path(f"{kind or kind_of(sources)}.pdf")
    check_output(path, PICTURE)
    request = Request(
        sources, metrics=_names(metric), names=name or (), only=only or (), against=against,
        scene=scene, episode=episode, width=None if width is None else length(width),
    )  # fmt: skip
    drawn = draw(request, kind=kind, average=average, style=style, tell=print_note)
    about = [shlex.join(["flipperctl", *sys.argv[1:]]), *drawn.sources]
    save(drawn.figure, path, "; ".join(about))
    print_note(f"wrote {path}")


def _names(text: str | None) -> list[str]:
    names = [] if text is None else [name.strip() for name in text.split(",")]
    if not all(names) or len(set(names)) < len(names):
        raise RequestError(f"--metric: different names between commas are allowed; got {text!r}")
    return names
