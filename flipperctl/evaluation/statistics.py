"""The summary of episodes, and the differences of two policies' episodes at equal seeds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from flipperctl.api import Measure, Outcome
from flipperctl.env.metrics import occurring
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.estimates import Estimate, Interval, PairedDifference
from flipperctl.evaluation.intervals import interval, paired_success, proportion
from flipperctl.evaluation.results import Differences, NotReached, Outcomes, Passable, Summary
from flipperctl.evaluation.risk import summarise_risk

Row = Mapping[str, Any]
"""A flat row of ``rollout.episode.play``."""
Pair = tuple[EpisodeResult, EpisodeResult]


def reached(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of episodes that reached the finish."""
    return [row for row in rows if row["outcome"] == Outcome.REACHED]


def summarise(terrain: str, episodes: Sequence[EpisodeResult]) -> Summary:
    """Return the summary of one policy's episodes on a terrain.

    Raises:
        ValueError: there are no episodes.
    """
    parts = {label: _summary(label, part, {}) for label, part in _parts(episodes).items()}
    return _summary(terrain, episodes, parts)


def _parts(episodes: Sequence[EpisodeResult]) -> dict[str, list[EpisodeResult]]:
    """Return the episodes of each kind of terrain, if there is more than one kind."""
    labels = sorted({e.terrain for e in episodes})
    if len(labels) < 2:
        return {}
    return {label: [e for e in episodes if e.terrain == label] for label in labels}


def _summary(
    terrain: str, episodes: Sequence[EpisodeResult], parts: Mapping[str, Summary]
) -> Summary:
    success = _success(episodes)
    good = [e for e in episodes if e.reached]
    return Summary(
        terrain,
        len(episodes),
        success_rate=len(good) / len(episodes),
        success=success,
        outcomes=Outcomes.of(e.outcome for e in episodes),
        t_cost=_measure([e.t_cost for e in good]),
        pitch_variation=_measure([e.pitch_variation for e in good]),
        pitch_variation_100hz=_measure([e.pitch_variation_100hz for e in good]),
        flipper_travel=_measure([e.flipper_travel for e in good]),
        max_pitch=measure([e.max_pitch for e in episodes]),
        episode_return=measure([e.episode_return for e in episodes]),
        further={
            m.plugin_name: _measure(_further(m, good if m.reached_only else episodes))
            for m in occurring(e.further for e in episodes)
        },
        passable=_passable(episodes),
        parts=parts,
        not_reached=_not_reached([e for e in episodes if not e.reached]),
        search=_search(episodes),
        static_bound=_measure([e.static_bound for e in good if e.static_bound is not None]),
        risk=summarise_risk([(e.risks, not e.reached) for e in episodes if e.risks is not None]),
    )


def _search(episodes: Sequence[EpisodeResult]) -> dict[str, float | Mapping[str, int]]:
    """Return the mean of each number that searches reported, and the counts of each word."""
    found: dict[str, float | Mapping[str, int]] = {}
    for name in episodes[0].search:
        values = [e.search[name] for e in episodes if name in e.search]
        words = [value for value in values if isinstance(value, str)]
        numbers = [value for value in values if not isinstance(value, str)]
        found[name] = dict(Counter(words).most_common()) if words else sum(numbers) / len(numbers)
    return found


def _further(measure: type[Measure], episodes: Sequence[EpisodeResult]) -> list[float]:
    return [e.further[measure.plugin_name] for e in episodes if measure.plugin_name in e.further]


def _success(episodes: Sequence[EpisodeResult]) -> Interval:
    return proportion(sum(e.reached for e in episodes), len(episodes))


def _passable(episodes: Sequence[EpisodeResult]) -> Passable | None:
    if all(e.crossed_by is None for e in episodes):
        return None
    # An episode that no reference crosses is no evidence against the policy.
    fair = [e for e in episodes if e.crossed_by]
    beyond = sum(e.reached for e in episodes if not e.crossed_by)
    if not fair:
        return Passable(0, None, None, beyond)
    success = _success(fair)
    return Passable(len(fair), success.mean, success, beyond)


def _not_reached(failed: Sequence[EpisodeResult]) -> NotReached | None:
    if not failed:
        return None
    return NotReached(
        len(failed),
        duration=measure([e.t_cost for e in failed]),
        pitch_variation=measure([e.pitch_variation for e in failed]),
        pitch_variation_100hz=measure([e.pitch_variation_100hz for e in failed]),
        flipper_travel=measure([e.flipper_travel for e in failed]),
        further={
            m.plugin_name: measure(_further(m, failed))
            for m in occurring(e.further for e in failed)
            if m.reached_only
        },
    )


def measure(values: Sequence[float]) -> Estimate:
    """Return the mean, interval and range of (K,) values.

    Raises:
        ValueError: there are no values.
    """
    found = interval(values)
    return Estimate(found.mean, found.low, found.high, float(max(values) - min(values)))


def _measure(values: Sequence[float]) -> Estimate | None:
    return measure(values) if values else None


def differences(ours: Sequence[EpisodeResult], theirs: Sequence[EpisodeResult]) -> Differences:
    """Return the mean differences of success and measures at equal seeds, ours minus theirs.

    Raises:
        ValueError: the episodes have no seed in common.
    """
    pairs = {label: paired(part, theirs) for label, part in _parts(ours).items()}
    parts = {label: _differences(found, {}) for label, found in pairs.items() if found}
    return _differences(paired(ours, theirs), parts)


def paired(ours: Sequence[EpisodeResult], theirs: Sequence[EpisodeResult]) -> list[Pair]:
    """Return the pairs of episodes of equal seeds."""
    others = {e.seed: e for e in theirs}
    return [(e, others[e.seed]) for e in ours if e.seed in others]


def _differences(played: Sequence[Pair], parts: Mapping[str, Differences]) -> Differences:
    pairs = [(mine, other) for mine, other in played if mine.reached and other.reached]
    shared = occurring(e.further for pair in played for e in pair)
    return Differences(
        success=paired_success(
            sum(mine.reached and not other.reached for mine, other in played),
            sum(other.reached and not mine.reached for mine, other in played),
            len(played),
        ),
        t_cost=_difference(pairs, lambda e: e.t_cost),
        pitch_variation=_difference(pairs, lambda e: e.pitch_variation),
        pitch_variation_100hz=_difference(pairs, lambda e: e.pitch_variation_100hz),
        further={m.plugin_name: _further_difference(m, played) for m in shared},
        parts=parts,
    )


def _further_difference(measure: type[Measure], played: Sequence[Pair]) -> PairedDifference | None:
    pairs = [
        (mine, other)
        for mine, other in played
        if measure.plugin_name in mine.further and measure.plugin_name in other.further
        if not measure.reached_only or (mine.reached and other.reached)
    ]
    return _difference(pairs, lambda e: e.further[measure.plugin_name])


def _difference(
    pairs: Sequence[Pair], value: Callable[[EpisodeResult], float]
) -> PairedDifference | None:
    if not pairs:
        return None
    found = interval([value(mine) - value(other) for mine, other in pairs])
    return PairedDifference(found.mean, found.low, found.high, len(pairs))
