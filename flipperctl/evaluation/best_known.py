"""The best policy that a folder of stored episodes knows on a scene.

In: the result of an evaluation and its store. Out: the result with a row for that policy, whose
episodes are read and not played.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from flipperctl.config.identity import content_digest
from flipperctl.evaluation.evaluate import Played, Result
from flipperctl.evaluation.plan import BEST_KNOWN
from flipperctl.evaluation.rows import Episodes
from flipperctl.evaluation.store import EpisodeStore, FolderStore, ground, versions_here

_DIGEST = 8  # digits of a policy's digest in its label


def with_best_known(result: Result, store: EpisodeStore) -> Result:
    """Return the result with a row for the best stored policy, after the rows of each scene.

    The best has the highest success, and of those the smallest mean θ̂_R of the episodes that
    reached the finish. It must have every episode of the scene, with the same seed. There is no row
    where one of the evaluated policies is the best, or without a folder of blocks.
    """
    if not isinstance(store, FolderStore):
        return result
    # Equal ground makes a scene, on which policies can be ranked.
    scenes: dict[tuple[str, str, int, int], list[Played]] = {}
    for item in result.played:
        scenes.setdefault(item.entry.ground, []).append(item)
    for together in scenes.values():
        if (best := _best(together, store)) is not None:
            together.append(best)
    return replace(result, played=tuple(item for together in scenes.values() for item in together))


def _best(together: Sequence[Played], store: FolderStore) -> Played | None:
    """Return the best stored policy with all episodes of a scene; ``together``: the scene's rows.

    None if there is none, or one of the rows is as good.
    """
    entry = together[0].entry
    indices = range(entry.config.eval.episodes)
    # Only policies with every episode of the scene can be compared.
    complete = [
        (headers, Episodes(tuple(rows[index] for index in indices)))
        for headers, rows in store.stored_on(ground(entry.config))
        if all(index in rows for index in indices)
    ]
    if not complete:
        return None
    headers, episodes = max(complete, key=lambda policy_run: _rank(policy_run[1]))
    if any(_rank(row.episodes) >= _rank(episodes) for row in together):
        return None
    # Episodes of other versions are counted, as if they had been read for an entry.
    here = versions_here(entry.config)
    for header in headers:
        store.count_versions(header, here)
    # The digest tells the policy from another one that has its name by now.
    label, digest = str(headers[0]["controller"]), str(headers[0]["policy"])
    changed = (file := Path(label)).is_file() and content_digest(file) != digest
    if changed or any(row.entry.label == label for row in together):  # another one has the name now
        label = f"{label}, {digest[:_DIGEST]}"
    method = f"{BEST_KNOWN} ({label})"
    stored = replace(entry, method=method, training_seed=None, is_baseline=False, stored=label)
    return Played(stored, episodes)


def _rank(episodes: Episodes) -> tuple[float, float]:
    """Return what orders policies on equal episodes, the best last."""
    variations = episodes.reached.values("pitch_variation_100hz")
    if not variations:
        return 0.0, float("-inf")
    return len(variations) / len(episodes), -sum(variations) / len(variations)
