"""Figures of runs, sweeps, results and maps, for the command and the Python interface.

In: what is to be drawn, by paths and names. Out: a figure, and the files that it shows.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from flipperctl.errors import RequestError
from flipperctl.text.messages import unknown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from flipperctl.views.plot import Request

Sort = Literal["run", "results", "map"]
KINDS: dict[str, Sort] = {
    "curves": "run",
    "intervals": "results",
    "heat": "results",
    "differences": "results",
    "profiles": "results",
    "series": "results",
    "poses": "results",
    "map": "map",
}
"""What each kind is drawn from; the first kind of a sort is its default."""
_FROM = {
    "run": "runs or the folder of a sweep",
    "results": "a folder of flipperctl eval --output",
    "map": "a folder of flipperctl map --output",
}
_EPISODES = ("series", "poses")
_OWN = {"--against": ("differences",), "--scene": _EPISODES, "--episode": _EPISODES}
"""Options that have a meaning for some kinds alone."""
_UNITS = {"": 1.0, "in": 1.0, "cm": 1 / 2.54, "mm": 1 / 25.4, "pt": 1 / 72}  # [in]
_NARROWEST, _WIDEST = 2.0, 30.0  # width of a figure [in]


@dataclass(frozen=True)
class Drawn:
    """A figure, and what it was drawn from."""

    figure: Figure
    sources: tuple[str, ...]
    """Each file with the first digits of its SHA-256."""


def draw(
    request: Request,
    *,
    kind: str | None = None,
    average: str = "mean",
    style: str = "paper",
    tell: Callable[[str], None] = lambda text: None,
) -> Drawn:
    """Return the figure of a kind, by default the first one for what is named.

    ``tell`` is called with lines on what the figure leaves out.

    Raises:
        RequestError: there is nothing to draw, a name or a kind does not fit, or a value is wrong.
    """
    from flipperctl.figures.figure import SLIDE, styled

    sources = request.folders
    if not sources:
        raise RequestError(f"nothing is named to draw; allowed: {', '.join(_FROM.values())}")
    kind = kind or kind_of(sources)
    _known("--kind", kind, list(KINDS))
    for source in sources:
        if (sort := _sort(source)) != KINDS[kind]:
            fitting = ", ".join(name for name, shown in KINDS.items() if shown == sort)
            raise RequestError(
                f"--kind {kind}: it is drawn from {_FROM[KINDS[kind]]}; of {source}: {fitting}"
            )
    _known("--style", style, ["paper", "slides"])
    _known("--average", average, ["mean", "iqm"])
    options = {"--against": request.against, "--scene": request.scene, "--episode": request.episode}
    for option, value in options.items():
        if value is not None and kind not in (kinds := _OWN[option]):
            raise RequestError(
                f"{option}: it has a meaning for --kind {' and '.join(kinds)} alone, not {kind}"
            )
    if request.width is None and style == "slides":
        request = replace(request, width=SLIDE)
    with styled("slides" if style == "slides" else "paper"):
        if kind == "curves":
            return _curves(request, "iqm" if average == "iqm" else "mean", tell)
        if kind == "map":
            return _map(request)
        return _results(request, kind, tell)


def _known(option: str, value: str, known: Sequence[str]) -> None:
    if value not in known:
        raise RequestError(unknown(f"{option}: there is no", value, known))


def length(text: str) -> float:
    """Return a width in inches of a text such as ``3.5in``.

    Raises:
        RequestError: it is no length, or too small or too large.
    """
    match = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*([a-z]*)\s*", text)
    allowed = f"{_NARROWEST:g}in to {_WIDEST:g}in are allowed, in in, cm, mm or pt"
    if match is None or match[2] not in _UNITS:
        raise RequestError(f"--width {text}: it is no length; {allowed}")
    inches = float(match[1]) * _UNITS[match[2]]
    if not _NARROWEST <= inches <= _WIDEST:
        raise RequestError(f"--width {text}: {allowed}")
    return inches


def _sort(source: str) -> Sort:
    """Return what lies at a path."""
    from flipperctl import checkpoint
    from flipperctl.checkpoint.results import CONFIG, METRICS
    from flipperctl.evaluation.stored import FILE, named_path

    _, path = named_path(source)
    if (path / "map.json").is_file():
        return "map"
    if (path / FILE).is_file() or any(path.glob(f"*/{FILE}")):
        return "results"
    files = (path / METRICS, path / CONFIG)
    if path.is_dir() and (any(map(Path.is_file, files)) or checkpoint.runs_in(path)):
        return "run"
    there = "there is no such folder" if not path.exists() else "there is nothing to draw in it"
    raise RequestError(f"{path}: {there}; allowed: {', '.join(_FROM.values())}")


def kind_of(sources: Sequence[str]) -> str:
    """Return the default kind of what is named."""
    sort = _sort(sources[0])
    return next(kind for kind, shown in KINDS.items() if shown == sort)


def _digest(*files: Path) -> tuple[str, ...]:
    from flipperctl.config.identity import content_digest

    return tuple(f"{file} (SHA-256 {(content_digest(file) or '')[:12]})" for file in files)


def _curves(
    request: Request, average: Literal["mean", "iqm"], tell: Callable[[str], None]
) -> Drawn:
    from flipperctl.checkpoint.results import METRICS, holds_run, is_held
    from flipperctl.evaluation.names import renamed, taken
    from flipperctl.evaluation.plan import entrants
    from flipperctl.evaluation.stored import named_path
    from flipperctl.figures import curves
    from flipperctl.figures.figure import places
    from flipperctl.training.folder import read_run
    from flipperctl.views.plot import rules

    runs: dict[str, list[Path]] = {}
    names: dict[str, str] = {}  # names that the user gave with the paths
    for source in request.folders:
        named, path = named_path(source)
        if holds_run(path) or (path / METRICS).is_file():
            folders = {str(path): [path]}
        else:
            folders = {}
            for entrant in entrants([str(path)], tell):
                if entrant.run is not None:
                    folders.setdefault(entrant.method, []).append(entrant.run)
            if named and len(folders) > 1:
                raise RequestError(
                    f"{source}: the sweep has {len(folders)} methods, {', '.join(folders)}; "
                    "--name NAME=METHOD names each"
                )
        for method, members in folders.items():
            name = named or method
            names |= {name: name} if named else {}
            runs.setdefault(name, []).extend(m for m in members if m not in runs.get(name, ()))
    free = renamed([name for name in runs if name not in names], request.names)
    called = {name: names.get(name) or free[name] for name in runs}
    at = {called[name]: place for name, place in places(list(runs), rules()).items()}
    if request.only:
        called = {
            label: called[label] for label in (taken(o, called, "--only") for o in request.only)
        }
    runs = {name: runs[name] for name in called}
    rows = {called[name]: [[*chain(*read_run(run))] for run in each] for name, each in runs.items()}
    for run in (run for each in runs.values() for run in each):
        if is_held(run):
            tell(f"{run} is still training; it is drawn as far as it is")
    metrics = request.metrics or curves.METRICS
    figure = curves.curves_figure(rows, metrics, average=average, places=at, **request.sized())
    if max(map(len, rows.values())) > 1 or len(rows) > 1:
        of = "validations" if curves.uses_validations(rows) else (
            f"training episodes, each point a mean of {curves.window(rows)}, since a run has fewer "
            f"than {curves.FEWEST_VALIDATIONS} validations"
        )  # fmt: skip
        tell(f"curves of {of}")
    if few := [n for n, e in rows.items() if 1 < len(e) < curves.FEWEST_SEEDS]:
        tell(
            f"bands from the smallest to the largest seed, of which there are few: {', '.join(few)}"
        )
    files = [run / METRICS for each in runs.values() for run in each]
    return Drawn(figure, _digest(*files))


def _map(request: Request) -> Drawn:
    from flipperctl.figures.map import map_figure

    if len(request.folders) > 1 or request.metrics or request.names:
        raise RequestError("--kind map: it takes one folder, without --metric and --name")
    (file,) = (path / "map.json" for path in request.paths())
    try:
        figure = map_figure(json.loads(file.read_text(encoding="utf-8")), **request.sized())
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise RequestError(f"{file}: it is damaged, or no map: {error}") from error
    return Drawn(figure, _digest(file))


def _results(request: Request, kind: str, tell: Callable[[str], None]) -> Drawn:
    from flipperctl.evaluation.stored import FILE
    from flipperctl.views import plot as view

    figure, notices = view.KINDS[kind](request)
    for notice in notices:
        tell(f"warning: {notice}")
    groups = [sorted({*path.glob(FILE), *path.glob(f"*/{FILE}")}) for path in request.paths()]
    return Drawn(figure, _digest(*(file for files in groups for file in files)))
