"""The files of an evaluation: ``episodes.csv`` with a row per episode, ``summary.json``, tables.

Recorded episodes, decision by decision, go to a file of their own.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from flipperctl.checkpoint import recording
from flipperctl.config import EvalConfig
from flipperctl.evaluation.conditions import Conditions, scene_names
from flipperctl.evaluation.results import EvaluationResult
from flipperctl.evaluation.scenes import Scene
from flipperctl.evaluation.tables import write_tables
from flipperctl.files import write_csv, write_json

SUMMARY = "summary.json"
NAMES = ("episodes.csv", SUMMARY, "table.csv", "table.tex")
"""Names of the files that ``write`` writes."""


def write(folder: Path, result: EvaluationResult) -> None:
    """Write all files into an existing folder, each completely or not at all.

    Raises:
        OutputError: a file cannot be written.
        WriteError: writing failed half way; an earlier file, if any, is kept.
    """
    write_csv(folder / "episodes.csv", list(episode_rows(result)))
    write_json(folder / SUMMARY, result.to_dict())
    write_tables(folder, result)


def replaced(folder: Path, result: EvaluationResult) -> str:
    """Return, in words, the rows of earlier tables in a folder that a result lacks; "" for none.

    A row of more episodes, or with a baseline that there is no longer, is lost, too.
    """
    try:
        earlier = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))["scenes"]
        rows = [row for scene in earlier for row in _rows_of(scene)]
        now = [row for scene in result.scenes for row in _rows_of(scene.to_dict())]
        most = dict(sorted(now, key=lambda one: one[1]))
        lost = [(row, count) for row, count in rows if count > most.get(row, 0)]
    except (OSError, ValueError, LookupError, TypeError):
        return ""  # there are none
    first = [
        f"{who} on {terrain}, seed {seed}, {count} episodes"
        for (terrain, who, seed, _), count in lost[:1]
    ]
    return " and ".join([*first, *([f"{len(lost) - 1} more rows"] if len(lost) > 1 else [])])


def _rows_of(scene: Mapping[str, Any]) -> Iterator[tuple[tuple[str, str, int, str], int]]:
    """Yield what tells each policy of a scene in ``summary.json`` apart, and its episodes."""
    terrain, seed, sampled = scene["terrain"], scene["seed"], scene["conditions"]["hash"]
    first = [scene["baseline"]] if "baseline" in scene else []
    others = scene.get("baselines", first)
    for who in (scene["controller"], *(other["controller"] for other in others)):
        yield (terrain, who, seed, sampled), scene["episodes"]


def episode_rows(result: EvaluationResult) -> Iterator[dict[str, Any]]:
    """Yield a flat row per episode; in each scene the policy's precede its baselines'."""
    for scene in result.scenes:
        conditions = {
            "conditions": scene.conditions.name,
            "conditions_hash": scene.conditions.hash,
            **scene.name.to_dict(),
        }
        players = [(scene.row_label, scene.episodes)]
        players += [(other.controller, other.episodes) for other in scene.baselines]
        for label, episodes in players:
            for episode in episodes:
                who = {"scene": scene.terrain, "controller": label}
                yield {**who, **episode.row(), **conditions}


def write_recording(path: Path, scenes: Sequence[Scene], result: EvaluationResult) -> None:
    """Write the policy's recorded episodes on all scenes, evaluated with ``record``.

    The result may lack scenes.

    Raises:
        ConfigError: the scenes have several observation layouts.
        OutputError: the file cannot be written.
        WriteError: writing failed half way; an earlier file, if any, is kept.
    """
    parts = [
        (scenes[scene.index][0], [e.recorded for e in scene.episodes if e.recorded is not None])
        for scene in result.scenes
        if scene.index is not None
    ]
    recording.write(path, result.controller, parts)


def picture_names(scenes: Sequence[EvalConfig]) -> list[str]:
    """Return a file name per scene: its terrain, and its conditions if a terrain has several."""
    named = scene_names([(c.terrain.plugin_name, Conditions.of(c)) for c in scenes])
    return ["_".join(re.findall(r"\w+", name)) + ".png" for name in named]
