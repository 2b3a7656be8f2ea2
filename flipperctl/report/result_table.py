"""Tables of stored results in Markdown.

In: stored rows and the names of columns. Out: the lines of a table. With the column ``method`` it
has a row for each scene and method; otherwise one for each scene, and a column such as
``swing:okada`` shows the baseline.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from flipperctl.errors import RequestError
from flipperctl.evaluation.result_rows import Ends, StoredRow
from flipperctl.messages import close_match

NONE = "–"
"""Text of a missing number."""


def ends_text(ends: Ends | None, digits: int, *, interval: bool = True) -> str:
    """Return a mean with ``digits`` decimals and, if there is one, its interval."""
    if ends is None:
        return NONE
    mean, low, high = ends
    text = f"{mean:.{digits}f}"
    if not interval or low is None or high is None:
        return text
    return f"{text} [{low:.{digits}f}, {high:.{digits}f}]"


@dataclass(frozen=True)
class _Column:
    heading: str
    text: Callable[[StoredRow], str]


def _measured(name: str, heading: str, digits: int) -> dict[str, _Column]:
    """Return the column of a measure, and with a ``+`` the one with intervals."""

    def column(interval: bool) -> _Column:
        return _Column(
            heading, lambda row: ends_text(row.measures[name], digits, interval=interval)
        )

    return {"": column(False), "+": column(True)}


def _columns() -> dict[str, _Column]:
    found = {
        "terrain": _Column("terrain", lambda row: f"`{row.terrain}`"),
        "conditions": _Column("conditions", lambda row: f"{row.conditions} {row.hash}"),
        "engine": _Column("engine", lambda row: row.engine),
        "method": _Column("policy", lambda row: f"`{row.method}`"),
        "n": _Column("episodes", lambda row: str(row.episodes)),
        "reached": _Column("reached", lambda row: str(row.reached)),
        "stuck": _Column("stuck", lambda row: str(row.outcomes["stuck"])),
        "overturned": _Column("overturned", lambda row: str(row.outcomes["overturned"])),
        "timeout": _Column("timeout", lambda row: str(row.outcomes["timeout"])),
        "success": _Column("success", lambda row: ends_text(row.success, 3)),
        "difference": _Column(
            "policy's θ̂_R minus this [rad]", lambda row: ends_text(row.difference, 2)
        ),
    }
    for name, measure, heading, digits in (
        ("swing", "pitch_variation_100hz", "θ̂_R [rad]", 2),
        ("decisions", "pitch_variation", "θ̂_R at decisions [rad]", 2),
        ("time", "t_cost", "t_cost [s]", 1),
        ("pitch", "max_pitch", "largest pitch [rad]", 2),
        ("travel", "flipper_travel", "flipper travel [rad]", 1),
    ):
        found |= {f"{name}{s}": c for s, c in _measured(measure, heading, digits).items()}
    return found


COLUMNS = _columns()
"""Columns by name; ``+`` adds the intervals of a measure."""


def markdown_table(rows: Sequence[StoredRow], names: Sequence[str]) -> list[str]:
    """Return the lines of a table with the named columns.

    Raises:
        RequestError: there is no such column, or no such method in a scene.
    """
    columns = [_find(name) for name in names]
    if "method" in names:
        cells = [[column.text(row) for column, _ in columns] for row in rows]
    else:
        cells = [
            [column.text(_method(scene, method)) for column, method in columns]
            for scene in _scenes(rows)
        ]
    headings = [_heading(column, method) for column, method in columns]
    return [_line(headings), "|" + "---|" * len(headings), *map(_line, cells)]


def _find(name: str) -> tuple[_Column, str | None]:
    """Return a column and the method that it shows; None for the policy."""
    quantity, _, method = name.partition(":")
    if quantity not in COLUMNS:
        raise RequestError(
            f"{name}: there is no such column{close_match(quantity, COLUMNS)}; known: "
            f"{', '.join(COLUMNS)}"
        )
    return COLUMNS[quantity], method or None


def _heading(column: _Column, method: str | None) -> str:
    if method is None:
        return column.heading
    if column is COLUMNS["difference"]:
        return f"θ̂_R minus `{method}`'s"
    return f"`{method}`: {column.heading}"


def _scenes(rows: Sequence[StoredRow]) -> list[list[StoredRow]]:
    """Return the rows of each scene, the policy's first."""
    scenes: list[list[StoredRow]] = []
    for row in rows:
        if row.is_policy:
            scenes.append([])
        scenes[-1].append(row)
    return scenes


def _method(scene: Sequence[StoredRow], method: str | None) -> StoredRow:
    for row in scene:
        if row.is_policy if method is None else row.method == method:
            return row
    known = ", ".join(row.method for row in scene)
    raise RequestError(f"{scene[0].terrain}: there is no result of {method!r}; known: {known}")


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
