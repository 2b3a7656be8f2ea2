"""The best of all stored policies on each scene, beside those that a call evaluates.

In: a result and a store. Out: the result with a further row for each scene on which another stored
policy is better than all that were evaluated.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from flipperctl.config.identity import content_digest
from flipperctl.evaluation.evaluate import Played, Result
from flipperctl.evaluation.plan import BEST_KNOWN
from flipperctl.evaluation.rows import Episodes
from flipperctl.evaluation.store import EpisodeStore, FolderStore, ground, versions_here

_DIGITS = 8
"""Digits of a policy's digest in its label."""


def is_best_known(label: str) -> bool:
    """Return whether a row's label is that of the best stored policy."""
    return label.startswith(f"{BEST_KNOWN} (")


def with_best_known(result: Result, store: EpisodeStore) -> Result:
    """Return the result with a row for the best stored policy, after the rows of each scene.

    The best has the highest success, and of those the smallest mean θ̂_R of the episodes that
    reached the finish. It must have every episode of the scene, with the same seed. There is no row
    where one of the evaluated policies is the best, or without a folder of blocks.
    """
    if not isinstance(store, FolderStore):
        return result
    found: list[Played] = []
    scenes: dict[tuple[str, str, int, int], list[Played]] = {}
    for one in result.played:
        scenes.setdefault(one.entry.ground, []).append(one)
    for together in scenes.values():
        found += together
        if (best := _best(together, store)) is not None:
            found.append(best)
    return replace(result, played=tuple(found))


def _best(together: Sequence[Played], store: FolderStore) -> Played | None:
    """Return the best stored policy with all episodes of a scene, of which these are the rows.

    None if there is none, or one of the rows is as good.
    """
    entry = together[0].entry
    indices = range(entry.config.eval.episodes)
    complete = [
        (headers, Episodes(tuple(rows[index] for index in indices)))
        for headers, rows in store.stored_on(ground(entry.config))
        if all(index in rows for index in indices)
    ]
    if not complete:
        return None
    headers, episodes = max(complete, key=lambda one: _rank(one[1]))
    if any(_rank(row.episodes) >= _rank(episodes) for row in together):
        return None
    here = versions_here(entry.config)
    for header in headers:
        store.count_versions(header, here)
    label = _best_label(headers[0], {row.entry.label for row in together})
    method = f"{BEST_KNOWN} ({label})"
    stored = replace(entry, method=method, training_seed=None, is_baseline=False, stored=label)
    return Played(stored, episodes)


def _best_label(header: Mapping[str, Any], others: Collection[str]) -> str:
    """Return the name of a stored policy; with its digest if another one has that name by now."""
    label, digest = str(header["controller"]), str(header["policy"])
    file = Path(label)
    if label in others or (file.is_file() and content_digest(file) != digest):
        return f"{label}, {digest[:_DIGITS]}"
    return label


def _rank(episodes: Episodes) -> tuple[float, float]:
    """Return what orders policies on equal episodes, the best last."""
    variations = episodes.reached.values("pitch_variation_100hz")
    if not variations:
        return 0.0, float("-inf")
    return len(variations) / len(episodes), -sum(variations) / len(variations)
