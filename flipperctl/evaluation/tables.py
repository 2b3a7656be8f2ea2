"""Tables of an evaluation for papers: ``table.csv`` and ``table.tex``.

In: the result of an evaluation. Out: a row for each scene and method, where the methods of a scene
are the policy and then its baselines.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flipperctl.api import Measure
from flipperctl.env.metrics import heading, occurring, shown
from flipperctl.evaluation.estimates import Interval
from flipperctl.evaluation.results import EvaluationResult, SceneResult, Summary
from flipperctl.files import write_bytes, write_csv

_DIGITS = 4
"""Decimals of ``table.csv``."""
_HEADINGS = (
    "scene",
    "conditions",
    "method",
    "$n$",
    "reached",
    "success",
    r"$t_\mathrm{cost}$ [s]",
    r"$\hat\theta_R$ at 100\,Hz [rad]",
    r"$\hat\theta_R$ at decisions [rad]",
    "largest pitch [rad]",
    "flipper travel [rad]",
)
_LAST = r"$\hat\theta_R$ where not reached [rad]"
_ESCAPES = str.maketrans(
    {
        **{char: f"\\{char}" for char in "&%$#_{}"},
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
    }
)


@dataclass(frozen=True)
class Cell:
    """A mean over some episodes, as one entry of a table."""

    name: str
    """Key of the mean in the JSON of ``eval``."""
    mean: Interval | None
    digits: int
    """Decimals of its text."""


def interval_text(found: Interval | None, digits: int = 2, *, sign: str = "") -> str:
    """Return ``mean [low, high]``.

    A mean without an interval is followed by ``[–]``, and ``–`` stands for None.
    ``sign`` as in a format specification: ``+`` shows the sign of positive numbers too.
    """
    if found is None:
        return "–"
    if found.low is None or found.high is None:
        return f"{found.mean:{sign}z.{digits}f} [–]"
    mean, low, high = (f"{n:{sign}z.{digits}f}" for n in (found.mean, found.low, found.high))
    return f"{mean} [{low}, {high}]"


def write_tables(folder: Path, result: EvaluationResult) -> None:
    """Write ``table.csv`` and ``table.tex`` into an existing folder.

    Raises:
        OutputError: a file cannot be written.
        WriteError: writing failed half way; an earlier file, if any, is kept.
    """
    write_csv(folder / "table.csv", list(scene_rows(result, _DIGITS)))
    write_bytes(folder / "table.tex", latex(result).encode())


def measures_of(result: EvaluationResult) -> list[type[Measure]]:
    """Return the measures beyond those with fields of their own that any scene has."""
    return occurring(scene.summary.further for scene in result.scenes)


def latex(result: EvaluationResult) -> str:
    """Return a LaTeX tabular, which needs the package booktabs."""
    stopped = result.interruption
    further = shown(scene.summary.further for scene in result.scenes)
    headings = (*_HEADINGS, *(_escape(heading(measure)) for measure in further), _LAST)
    lines = [
        *([] if stopped is None else [f"% {_escape(stopped.text)}"]),
        *(
            f"% {_escape(_named(scene))}: seed {scene.seed}, conditions "
            f"{_escape(scene.conditions.name)} {scene.conditions.hash}"
            for scene in result.scenes
        ),
        "% 95 % intervals; needs \\usepackage{booktabs}",
        r"\begin{tabular}{lll" + "r" * (len(headings) - 3) + "}",
        r"\toprule",
        _latex_row(headings),
    ]
    for scene in result.scenes:
        lines.append(r"\midrule")
        names = _named(scene), scene.conditions.label
        for method, summary in _methods(scene):
            texts = [interval_text(c.mean, c.digits) for c in _cells(summary, further)]
            numbers = [str(summary.episodes), str(summary.outcomes.reached), *texts]
            # LaTeX's own dash, which every font has; names keep theirs.
            numbers = [number.replace("–", "--") for number in numbers]
            lines.append(_latex_row([*map(_escape, (*names, method)), *numbers]))
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _named(scene: SceneResult) -> str:
    """Return the terrain, and the name within the suite if there is one."""
    return f"{scene.terrain}, {scene.name.scene}" if scene.name.scene else scene.terrain


def _latex_row(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


def _escape(text: str) -> str:
    """Return the text for LaTeX, on one line."""
    return " ".join(text.split()).translate(_ESCAPES)


def scene_rows(result: EvaluationResult, digits: int | None = None) -> Iterator[dict[str, Any]]:
    """Yield the rows of ``table.csv``: one for each scene and method.

    ``digits``: decimals of the numbers; None leaves them as they are.
    """
    further = measures_of(result)
    for scene in result.scenes:
        for method, summary in _methods(scene):
            row: dict[str, Any] = {
                "scene": scene.terrain,
                "method": method,
                "n": summary.episodes,
                "reached": summary.outcomes.reached,
            }
            bound = [Cell("static_bound", summary.static_bound, 2)] if summary.static_bound else []
            for cell in (*_cells(summary, further), *bound):
                row |= _csv_cells(cell, digits)
            yield {
                **row,
                "seed": scene.seed,
                "conditions": scene.conditions.name,
                "conditions_hash": scene.conditions.hash,
                **{k: v for k, v in scene.name.to_dict().items() if k != "method"},
            }


def _csv_cells(cell: Cell, digits: int | None) -> dict[str, float | None]:
    """Return the mean and the ends of its interval, each None where there is none."""
    found = cell.mean
    ends = (found.mean, found.low, found.high) if found else (None, None, None)
    names = (cell.name, f"{cell.name}_low", f"{cell.name}_high")
    return {
        name: end if end is None or digits is None else round(end, digits)
        for name, end in zip(names, ends, strict=True)
    }


def _methods(scene: SceneResult) -> list[tuple[str, Summary]]:
    baselines = [(other.controller, other.summary) for other in scene.baselines]
    return [(scene.row_label, scene.summary), *baselines]


def _cells(summary: Summary, further: Sequence[type[Measure]]) -> list[Cell]:
    failed = summary.not_reached
    return [
        Cell("success", summary.success, 3),
        Cell("t_cost", summary.t_cost, 1),
        Cell("pitch_variation_100hz", summary.pitch_variation_100hz, 2),
        Cell("pitch_variation", summary.pitch_variation, 2),
        Cell("max_pitch", summary.max_pitch, 2),
        Cell("flipper_travel", summary.flipper_travel, 2),
        *(Cell(m.plugin_name, summary.further.get(m.plugin_name), m.digits) for m in further),
        Cell(
            "not_reached_pitch_variation_100hz",
            failed.pitch_variation_100hz if failed else None,
            2,
        ),
    ]
