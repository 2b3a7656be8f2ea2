"""A map of capability as files, a figure and text.

In: a ``CapabilityMap`` of ``evaluation.map``. Out: its files with records of failures, and lines.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from flipperctl.evaluation.map import DIGITS, CapabilityMap, grid_config
from flipperctl.evaluation.replay import EpisodeRecord
from flipperctl.text.files import write_csv, write_json

NAMES = ("map.json", "map.csv", "map.png", "failure_map_*.json")  # names of the files of a map
MOST_FAILURES = 20  # largest number of failures that are recorded [-]


def write(folder: Path, mapped: CapabilityMap) -> None:
    """Write all files of a map into an existing folder.

    Failures nearest to the boundary come first: at points whose success is closest to one half.
    """
    from flipperctl.figures.figure import WIDTH, save
    from flipperctl.figures.map import map_figure

    document = mapped.to_dict()
    write_json(folder / "map.json", document)
    write_csv(folder / "map.csv", mapped.rows())
    about = f"{mapped.title}, conditions {mapped.entry.conditions.label}"
    save(map_figure(document, width=WIDTH), folder / "map.png", about)
    # Failures near the boundary tell the most.
    points = sorted(mapped.failures, key=lambda at: (abs(mapped.points[at].success - 0.5), at))
    for i, j in points[:MOST_FAILURES]:
        row, config = mapped.failures[i, j], grid_config(mapped.entry.config, mapped.axes, (i, j))
        record = EpisodeRecord.of(config, mapped.entry.source, row)
        name = f"failure_map_{i}_{j}_{row['episode']}.json"
        write_json(folder / name, record.model_dump(mode="json"))


def lines(mapped: CapabilityMap) -> Iterator[str]:
    """Yield the success of each point as text; a dot marks those that are interpolated."""
    first, second = mapped.axes
    columns, rows = mapped.size
    # Every column is as wide as the widest text.
    heads, below = _heads(second.values), _heads(first.values)
    indent, width = max(map(len, heads)), max(4, 1 + max(map(len, below)))
    texts = {
        at: f"{'' if point.episodes else '·'}{100 * point.success:.3g}"
        for at, point in mapped.points.items()
    }
    yield f"{mapped.title}: success [%]"
    yield f"columns: {first.label}; rows: {second.label}"
    for j in reversed(range(rows)):
        row = "".join(f"{texts.get((i, j), '–'):>{width}}" for i in range(columns))
        yield f"{heads[j]:>{indent}} {row}"
    yield f"{'':{indent}} " + "".join(f"{value:>{width}}" for value in below)
    yield (
        f"{mapped.played} of {columns * rows} points played, {mapped.entry.config.eval.episodes} "
        "episodes each; dots: interpolated"
    )
    if words := mapped.entry.conditions.line([key for axis in mapped.axes for key in axis.keys]):
        yield f"conditions {mapped.entry.conditions.name}, but for the axes: {words}"


def _heads(values: Sequence[float]) -> list[str]:
    """Return the values with the fewest digits, two or more, that tell them apart."""
    texts = ([f"{value:.{n}g}" for value in values] for n in range(2, DIGITS))
    apart = (heads for heads in texts if len(set(heads)) == len(heads))
    return next(apart, [f"{value:.{DIGITS}g}" for value in values])
