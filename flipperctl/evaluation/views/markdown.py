"""Stored results as tables in Markdown: a row for each scene and method.

In: the document of ``eval --json`` or of ``summary.json``, or rows of it that are kept in a
repository. Out: the lines of a table. With the column ``method`` it has a row for each scene and
method; otherwise one for each scene, and a column such as ``swing:okada`` shows the baseline.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flipperctl.errors import RequestError
from flipperctl.evaluation.stored import SUMMARY
from flipperctl.evaluation.views.summary import compared
from flipperctl.messages import close_match

MEASURES = ("pitch_variation_100hz", "pitch_variation", "t_cost", "max_pitch", "flipper_travel")
"""Measures of a row; those over the episodes that reached the finish, but ``max_pitch``."""
RISK = (
    *("horizon", "threshold", "failures", "announced", "reached"),
    *("false_alarms", "false_warnings"),
)
"""What a row keeps of how a policy's risk fits the ends of its episodes."""
Ends = Sequence[float | None]
"""Mean, and the ends of its 95 % interval, None for fewer than five values."""
StoredRow = dict[str, Any]
"""One method on one scene: ``terrain``, ``conditions`` and their ``hash``, ``engine``, ``seed``,
``method``, ``is_policy``, ``episodes``, ``outcomes``, ``success`` and ``measures`` as ends, the
policy's ``difference`` from a baseline in θ̂_R at 100 Hz, and counts of its ``risk``."""
NONE = "–"
"""Text of a missing number."""


def summary_file(folder_or_file: Path) -> Path:
    """Return the file of results in a folder of ``eval --output``, or the file itself."""
    return folder_or_file / SUMMARY if folder_or_file.is_dir() else folder_or_file


def read_rows(folder_or_file: Path) -> list[StoredRow]:
    """Return the rows of a folder of ``eval --output``, or of its ``summary.json``.

    Raises:
        RequestError: there is no such file, it holds no results of ``eval``, or not all of them.
    """
    path = summary_file(folder_or_file)
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise RequestError(f"{path}: it cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise RequestError(f"{path}: it is no JSON document: {error}") from error
    try:
        if document.get("interrupted"):
            raise RequestError(
                f"{path}: its evaluation was interrupted; eval with the same words and --output "
                "goes on"
            )
        if failed := document.get("failed"):
            raise RequestError(
                f"{path}: results are missing, since {failed[0]['controller']} failed on "
                f"{failed[0]['terrain']}"
            )
        return list(rows_of(document))
    except (KeyError, TypeError, AttributeError) as error:
        raise RequestError(f"{path}: it holds no results of eval; it lacks {error}") from error


def rows_of(document: Mapping[str, Any]) -> Iterator[StoredRow]:
    """Yield the rows of a document of ``eval --json``; in each scene the policy's is the first.

    Raises:
        KeyError: the document has another form.
    """
    for scene in document["scenes"]:
        yield _row(scene, scene, is_policy=True)
        for other in compared(scene):
            yield _row(scene, other, is_policy=False)


def _row(scene: Mapping[str, Any], method: Mapping[str, Any], *, is_policy: bool) -> StoredRow:
    conditions = scene["conditions"]
    told = _risk(method.get("risk"))
    return {
        "terrain": scene["terrain"],
        "conditions": conditions["name"],
        "hash": conditions["hash"],
        "engine": conditions["sim"]["name"],
        "seed": scene["seed"],
        "method": method["controller"],
        "is_policy": is_policy,
        "episodes": method["episodes"],
        "outcomes": dict(method["outcomes"]),
        "success": _ends(method["success"]),
        "measures": {name: _ends(method[name]) for name in MEASURES},
        "difference": None if is_policy else _ends(method["difference"]["pitch_variation_100hz"]),
        **({} if told is None else {"risk": told}),
    }


def _risk(found: Mapping[str, Any] | None) -> dict[str, float | None] | None:
    """Return the counts of a summary, without intervals and bins."""
    return None if found is None else {name: found[name] for name in RISK}


def _ends(interval: Mapping[str, Any] | None) -> Ends | None:
    """Return mean and ends, with the six digits that tables need at most."""
    if interval is None:
        return None
    low, high = (
        None if interval[end] is None else _round(interval[end]) for end in ("low", "high")
    )
    return _round(interval["mean"]), low, high


def _round(value: float) -> float:
    return float(f"{value:.6g}")


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
            heading, lambda row: ends_text(row["measures"][name], digits, interval=interval)
        )

    return {"": column(False), "+": column(True)}


def _columns() -> dict[str, _Column]:
    found = {
        "terrain": _Column("terrain", lambda row: f"`{row['terrain']}`"),
        "conditions": _Column("conditions", lambda row: f"{row['conditions']} {row['hash']}"),
        "engine": _Column("engine", lambda row: row["engine"]),
        "method": _Column("policy", lambda row: f"`{row['method']}`"),
        "n": _Column("episodes", lambda row: str(row["episodes"])),
        "reached": _Column("reached", lambda row: str(row["outcomes"]["reached"])),
        "stuck": _Column("stuck", lambda row: str(row["outcomes"]["stuck"])),
        "overturned": _Column("overturned", lambda row: str(row["outcomes"]["overturned"])),
        "timeout": _Column("timeout", lambda row: str(row["outcomes"]["timeout"])),
        "success": _Column("success", lambda row: ends_text(row["success"], 3)),
        "difference": _Column(
            "policy's θ̂_R minus this [rad]", lambda row: ends_text(row["difference"], 2)
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
        if row["is_policy"]:
            scenes.append([])
        scenes[-1].append(row)
    return scenes


def _method(scene: Sequence[StoredRow], method: str | None) -> StoredRow:
    for row in scene:
        if row["is_policy"] if method is None else row["method"] == method:
            return row
    known = ", ".join(row["method"] for row in scene)
    raise RequestError(f"{scene[0]['terrain']}: there is no result of {method!r}; known: {known}")


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
