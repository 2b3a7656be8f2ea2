"""Results of an evaluation as they were stored: a row for each scene and method.

In: the document of ``eval --json`` or of ``summary.json``. Out: rows with the numbers that tables
and cards show, which convert to smaller plain data that is kept in a repository.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from flipperctl.errors import RequestError
from flipperctl.evaluation.files import SUMMARY

MEASURES = ("pitch_variation_100hz", "pitch_variation", "t_cost", "max_pitch", "flipper_travel")
"""Measures of a row; those over the episodes that reached the finish, but ``max_pitch``."""
RISK = (
    "horizon",
    "threshold",
    "failures",
    "announced",
    "reached",
    "false_alarms",
    "false_warnings",
)
"""What a row keeps of how a policy's risk fits the ends of its episodes."""
Ends = tuple[float, float | None, float | None]
"""Mean, and the ends of its 95 % interval, None for fewer than five values."""


@dataclass(frozen=True)
class StoredRow:
    """One method on one scene."""

    terrain: str
    conditions: str
    """Name of the conditions."""
    hash: str
    """Hash of the conditions; equal for comparable results."""
    engine: str
    seed: int
    """Seed of the evaluation."""
    method: str
    """Label of the policy, or of the baseline."""
    is_policy: bool
    """Whether it is the evaluated policy, else a baseline."""
    episodes: int
    outcomes: Mapping[str, int]
    success: Ends
    measures: Mapping[str, Ends | None]
    """Means by name in SI units; None if no episode reached the finish."""
    difference: Ends | None = None
    """The policy's θ̂_R at 100 Hz minus this baseline's, over the episodes that both reached."""
    risk: Mapping[str, float | None] | None = None
    """Counts of ``RiskSummary`` for a policy that tells its risk."""

    @property
    def reached(self) -> int:
        """Number of episodes that reached the finish."""
        return self.outcomes["reached"]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, from which ``of`` makes an equal row."""
        return {n: v for n, v in asdict(self).items() if n != "risk" or v is not None}

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> StoredRow:
        """Return a row from its plain data."""
        ends = {name: _tuple(value) for name, value in plain["measures"].items()}
        success, difference = _tuple(plain["success"]), _tuple(plain["difference"])
        assert success is not None
        fields = {**plain, "measures": ends, "success": success, "difference": difference}
        return cls(**fields)


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
        first = [scene["baseline"]] if "baseline" in scene else []
        for other in scene.get("baselines", first):
            yield _row(scene, other, is_policy=False)


def _row(scene: Mapping[str, Any], method: Mapping[str, Any], *, is_policy: bool) -> StoredRow:
    conditions = scene["conditions"]
    success = _ends(method["success"])
    assert success is not None
    difference = None if is_policy else _ends(method["difference"]["pitch_variation_100hz"])
    return StoredRow(
        terrain=scene["terrain"],
        conditions=conditions["name"],
        hash=conditions["hash"],
        engine=conditions["sim"]["name"],
        seed=scene["seed"],
        method=method["controller"],
        is_policy=is_policy,
        episodes=method["episodes"],
        outcomes=dict(method["outcomes"]),
        success=success,
        measures={name: _ends(method[name]) for name in MEASURES},
        difference=difference,
        risk=_risk(method.get("risk")),
    )


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


def _tuple(values: Any) -> Ends | None:
    return None if values is None else (values[0], values[1], values[2])
