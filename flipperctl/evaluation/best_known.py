"""The best of all stored policies on each scene, beside those that a call evaluates.

In: a result, its scenes and a store. Out: the result with a further row for each scene on which
another stored policy is better than all that were evaluated.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

from flipperctl.config import EvalConfig
from flipperctl.config.identity import content_digest
from flipperctl.evaluation.cells import ground, versions_here
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.naming import SceneName
from flipperctl.evaluation.results import EvaluationResult, SceneResult
from flipperctl.evaluation.scenes import Scene
from flipperctl.evaluation.statistics import summarise
from flipperctl.evaluation.store import CellFolder, EpisodeStore

BEST_KNOWN = "best known"
"""How such rows are called, before the label of the policy in brackets."""
_DIGITS = 8
"""Digits of a policy's digest in its label."""


def is_best_known(label: str) -> bool:
    """Return whether a row's label is that of the best stored policy."""
    return label.startswith(f"{BEST_KNOWN} (")


def with_best_known(
    result: EvaluationResult, scenes: Sequence[Scene], store: EpisodeStore
) -> EvaluationResult:
    """Return the result with a row for the best stored policy, after the rows of each scene.

    The best has the highest success, and of those the smallest mean θ̂_R of the episodes that
    reached the finish. It must have every episode of the scene, with the same seed. There is no row
    where one of the evaluated policies is the best, or without a folder of cells.
    """
    if not isinstance(store, CellFolder):
        return result
    found: list[SceneResult] = []

    def scene(one: SceneResult) -> tuple[object, ...]:
        planned = None if one.index is None else scenes[one.index][0].eval.episodes
        return one.name.scene, one.conditions.hash, one.seed, planned

    for _, rows in groupby(result.scenes, scene):
        together = list(rows)
        first = together[0]
        best = None
        if first.index is not None:
            best = _best(scenes[first.index][0], together, store)
        found += together
        if best is not None:
            found.append(best)
    return replace(result, scenes=tuple(found))


def _best(
    config: EvalConfig, together: Sequence[SceneResult], store: CellFolder
) -> SceneResult | None:
    """Return the best stored policy with all episodes of a configuration.

    ``together``: the rows of the scene. None if there is none, or one of them is as good.
    """
    complete = [
        (headers, [episodes[index] for index in range(config.eval.episodes)])
        for headers, episodes in store.stored_on(ground(config))
        if all(index in episodes for index in range(config.eval.episodes))
    ]
    if not complete:
        return None
    headers, episodes = max(complete, key=lambda one: _rank(one[1]))
    if any(_rank(row.episodes) >= _rank(episodes) for row in together):
        return None
    here = versions_here(config)
    for header in headers:
        store.count_versions(header, here)
    label = _label(headers[0], {row.controller for row in together})
    return SceneResult(
        label,
        summarise(config.terrain.plugin_name, episodes),
        config.eval.seed,
        Conditions.of(config),
        (),
        tuple(episodes),
        SceneName(together[0].name.scene, f"{BEST_KNOWN} ({label})"),
    )


def _label(header: Mapping[str, Any], others: Collection[str]) -> str:
    """Return the name of a stored policy; with its digest if another one has that name by now."""
    label, digest = str(header["controller"]), str(header["policy"])
    file = Path(label)
    if label in others or (file.is_file() and content_digest(file) != digest):
        return f"{label}, {digest[:_DIGITS]}"
    return label


def _rank(episodes: Sequence[EpisodeResult]) -> tuple[float, float]:
    """Return what orders policies on equal episodes, the best last."""
    reached = [e.pitch_variation_100hz for e in episodes if e.reached]
    if not reached:
        return 0.0, float("-inf")
    return len(reached) / len(episodes), -sum(reached) / len(reached)
