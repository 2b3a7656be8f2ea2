"""Results by what was drawn: length, height, slope, friction.

In: the result of an evaluation and names of drawn numbers. Out: the same result, whose scenes hold
the episodes in groups of equal or similar numbers, each compared with the baselines.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from flipperctl.config import EvalConfig
from flipperctl.config.words import check_different
from flipperctl.env.ground import generate_profile
from flipperctl.errors import RequestError
from flipperctl.evaluation.comparisons import correct_together
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.results import BaselineResult, EvaluationResult, Group, SceneResult
from flipperctl.evaluation.scenes import compare
from flipperctl.evaluation.statistics import summarise
from flipperctl.messages import close_match

_MOST = 8
"""Largest number of different values that have a group each; more are split at their quartiles."""
_TRIES = 100
"""Number of profiles in which a name is looked for before the evaluation."""
_STARTS = ("start_shift", "start_front", "start_rear")

Names = tuple[str, ...]
"""Numbers whose combinations are groups."""


def parse(text: str | None, option: str, configs: Sequence[EvalConfig]) -> list[Names]:
    """Return the names in ``steps,slope+up``: a list of tables, each by one or several numbers.

    Raises:
        RequestError: a name is empty or repeated, or no scene draws such a number.
    """
    if text is None:
        return []
    found = [tuple(name.strip() for name in part.split("+")) for part in text.split(",")]
    if not all(all(names) and len(set(names)) == len(names) for names in found):
        raise RequestError(f"{option}: names as in steps,slope+up are allowed; got {text!r}")
    check_different(f"{option} {text}", ["+".join(sorted(names)) for names in found])
    for name in dict.fromkeys(name for names in found for name in names):
        known: dict[str, None] = {}
        for config in configs:
            if _draws(config, name, known):
                break
        else:
            raise RequestError(
                f"{option}: no scene draws {name!r}{close_match(name, known)}; "
                f"known: {', '.join(known)}"
            )
    return found


def _draws(config: EvalConfig, name: str, known: dict[str, None]) -> bool:
    """Return whether a scene draws a number of this name; add the names it draws to ``known``."""
    rng = np.random.default_rng(0)
    for attempt in range(_TRIES):
        if attempt == 0:
            known |= dict.fromkeys([*_STARTS, *config.sample(rng)])
        drawn = generate_profile(config.terrain, rng, 1.0).drawn
        known |= dict.fromkeys(drawn)
        if name in known:
            return True
    return False


def grouped(result: EvaluationResult, by: Sequence[Names]) -> EvaluationResult:
    """Return the result with the groups of each scene by each combination of numbers.

    A number with more than eight different values is split at its quartiles. Episodes without one
    of the numbers, such as other parts of a mix, are in no group.
    """
    if not by:
        return result
    scenes = [
        replace(scene, by={"+".join(names): tuple(_groups(scene, names)) for names in by})
        for scene in result.scenes
    ]
    return replace(result, scenes=tuple(_corrected(scenes)))


def _groups(scene: SceneResult, names: Names) -> Iterator[Group]:
    rows = [(e, [e.number(name) for name in names]) for e in scene.episodes]
    whole = [(e, [v for v in values if v is not None]) for e, values in rows if None not in values]
    if not whole:
        return
    columns = np.array([values for _, values in whole], dtype=float)  # (episodes, names)
    bins = np.column_stack([_bins(column) for column in columns.T])
    for key in product(*(np.unique(column) for column in bins.T)):
        chosen = np.flatnonzero((bins == key).all(axis=1))
        if chosen.size:
            part = columns[chosen]
            ends = zip(part.min(axis=0).tolist(), part.max(axis=0).tolist(), strict=True)
            episodes = [whole[index][0] for index in chosen]
            yield _group(scene, dict(zip(names, ends, strict=True)), episodes)


def _bins(
    values: np.ndarray[tuple[int], np.dtype[np.float64]],
) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the number of each value's bin, (K,)."""
    distinct, found = np.unique(values, return_inverse=True)
    if len(distinct) <= _MOST:
        return found
    return np.searchsorted(np.quantile(values, [0.25, 0.5, 0.75]), values, side="left")


def _group(
    scene: SceneResult, ranges: Mapping[str, tuple[float, float]], episodes: list[EpisodeResult]
) -> Group:
    seeds = {e.seed for e in episodes}
    others = [(b.controller, [e for e in b.episodes if e.seed in seeds]) for b in scene.baselines]
    compared = (compare(scene.terrain, episodes, label, own) for label, own in others if own)
    return Group(ranges, summarise(scene.terrain, episodes), tuple(compared))


def _corrected(scenes: Sequence[SceneResult]) -> Iterator[SceneResult]:
    """Yield the scenes with the p-values of all groups corrected together."""
    every = [
        b.difference
        for s in scenes
        for groups in s.by.values()
        for g in groups
        for b in g.baselines
    ]
    corrected = iter(correct_together(every))

    def again(found: Sequence[BaselineResult]) -> tuple[BaselineResult, ...]:
        return tuple(replace(b, difference=next(corrected)) for b in found)

    for scene in scenes:
        by = {
            name: tuple(replace(group, baselines=again(group.baselines)) for group in groups)
            for name, groups in scene.by.items()
        }
        yield replace(scene, by=by)
