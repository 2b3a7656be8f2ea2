"""Records of the failures of an evaluation, each of which can be played again.

In: the scenes and the result of an evaluation, or a map. Out: a file for each of the policy's first
failures, or for failures near the boundary of the map.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from flipperctl.config import EvalConfig
from flipperctl.evaluation.axes import cell_config
from flipperctl.evaluation.capability import CapabilityMap
from flipperctl.evaluation.conditions import Conditions, scene_names
from flipperctl.evaluation.episode_record import EpisodeRecord
from flipperctl.evaluation.results import EvaluationResult
from flipperctl.evaluation.scenes import Scene
from flipperctl.files import write_json
from flipperctl.policies.source import PolicySource

FAILURES, MAP_FAILURES = "failure_*.json", "failure_map_*.json"
"""Patterns of the names of records."""
MOST = 20
"""Largest number of failures of a scene that are recorded [-]."""


def write_failures(folder: Path, scenes: Sequence[Scene], result: EvaluationResult) -> list[str]:
    """Write the policy's first ``MOST`` failures of each scene; return the names of the files.

    The result may lack scenes.

    Raises:
        OutputError: a file cannot be written.
        WriteError: writing failed half way.
    """
    records = list(failure_records(scenes, result))
    for name, record in records:
        write_json(folder / name, record.model_dump(mode="json"))
    return [name for name, _ in records]


def write_map_failures(
    folder: Path, config: EvalConfig, source: PolicySource, found: CapabilityMap
) -> int:
    """Write a failure of each of ``MOST`` cells of a map; return the number of files.

    Cells nearest to the boundary come first: those whose success is closest to one half.

    Raises:
        OutputError: a file cannot be written.
        WriteError: writing failed half way.
    """
    cells = sorted(found.failures, key=lambda cell: (abs(found.cells[cell].success - 0.5), cell))
    for i, j in cells[:MOST]:
        episode = found.failures[i, j]
        record = EpisodeRecord.of(cell_config(config, found.axes, (i, j)), source, episode)
        name = f"failure_map_{i}_{j}_{episode.episode}.json"
        write_json(folder / name, record.model_dump(mode="json"))
    return len(cells[:MOST])


def failure_records(
    scenes: Sequence[Scene], result: EvaluationResult
) -> Iterator[tuple[str, EpisodeRecord]]:
    """Yield the name of a file and the record of each failure that is recorded.

    The result may lack scenes, and have rows of policies that did not play here.
    """
    names = scene_names([(c.terrain.plugin_name, Conditions.of(c)) for c, _ in scenes])
    several = len({source.label() for _, source in scenes}) > 1
    for scene in result.scenes:
        if scene.index is None:
            continue
        config, source = scenes[scene.index]
        words = ["failure", names[scene.index], *([scene.controller] if several else [])]
        stem = "_".join(re.findall(r"\w+", " ".join(words)))
        for episode in [e for e in scene.episodes if not e.reached][:MOST]:
            record = EpisodeRecord.of(config, source, episode)
            yield f"{stem}_{episode.episode}.json", record
