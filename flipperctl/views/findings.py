"""What an evaluation found, in sentences: who is best by how much, what is worse, what failed.

In: a document of ``eval --json``. Out: sentences, whose names of policies stand between ``**``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from flipperctl.api import Outcome
from flipperctl.evaluation.rows import Row
from flipperctl.text.messages import counted, percent
from flipperctl.text.show import with_minus
from flipperctl.views import evaluation
from flipperctl.views.summary import Document

RULER = "level"
"""The rule with which policies are compared, if it played."""
VARIATION = "pitch_variation_100hz"
RULE = (
    "Smaller is better. The best policy of a scene has the highest success, and then the smallest "
    "pitch variation, clearly so: by the difference on the same episodes, or by intervals that do "
    "not overlap. Brackets are 95 % intervals."
)
"""How the sentences are meant."""


Gaps = Mapping[tuple[str, str, str], Mapping[str, Any] | None]
"""Difference on the same episodes with its interval, by scene, policy and who it is compared to."""


def findings(evaluated: Document, gaps: Gaps = MappingProxyType({})) -> Iterator[tuple[str, str]]:
    """Yield sentences, each after ``good``, ``bad``, or an empty text for neither.

    ``gaps``: those of policies that the document does not compare itself.
    """
    rows = table_rows(evaluated)
    stored = {
        (difference["scene"], difference["policy"], difference["against"]): difference["variation"]
        for difference in evaluation.difference_rows(evaluated)
    }
    # What the table has, decides, in whichever direction.
    pairs = {*stored, *((scene, other, policy) for scene, policy, other in stored)}
    further = {at: gap for at, gap in gaps.items() if at not in pairs}
    known = {**further, **stored}
    yield from (*_best(rows, known), *_compared(further), *_losses(rows, known), *_failed(rows))


def _compared(gaps: Gaps) -> Iterator[tuple[str, str]]:
    """Yield the differences of each policy to the ruler."""
    texts: dict[str, list[str]] = {}
    for (scene, policy, other), gap in gaps.items():
        if other == RULER and gap is not None and gap["low"] is not None:
            ends = f"[{gap['low']:+.2f}, {gap['high']:+.2f}]"
            texts.setdefault(policy, []).append(f"{gap['mean']:+.2f} {ends} rad on {scene}")
    for policy, parts in texts.items():
        words = with_minus("; ".join(parts))
        yield "", f"**{policy}** against **{RULER}**, same episodes, failures counted: {words}."


def table_rows(evaluated: Document) -> list[Row]:
    """Return the rows of the table of policies, without the parts of mixes."""
    return [row for row in evaluation.policy_rows(evaluated) if not row.get("dim")]


def rank(row: Row) -> tuple[float, float]:
    """Return what orders policies on a scene, the best last."""
    variation = row[VARIATION]
    return row["success"]["mean"], -variation["mean"] if variation else -math.inf


def for_each_seed(rows: Iterable[Row]) -> str:
    """Return words for counts of episodes, which training seeds of a method have each."""
    return ", counted for each training seed" if any("seeds" in row for row in rows) else ""


def by_scene(rows: Iterable[Row]) -> dict[str, dict[str, Row]]:
    """Return the rows by scene and policy."""
    rows_of: dict[str, dict[str, Row]] = {}
    for row in rows:
        rows_of.setdefault(row["scene"], {})[row["policy"]] = row
    return rows_of


def _best(rows: Sequence[Row], gaps: Gaps) -> Iterator[tuple[str, str]]:
    """Yield who is best, by how much: on each of a few scenes, or counted.

    Only who is clearly better than all others is called the best.
    """
    scenes = {
        name: scene_rows for name, scene_rows in by_scene(rows).items() if len(scene_rows) > 1
    }
    best = {name: max(scene_rows.values(), key=rank) for name, scene_rows in scenes.items()}
    equals = {
        name: [
            other["policy"]
            for other in scenes[name].values()
            if other is not row and not _is_better(row, other, name, gaps)
        ]
        for name, row in best.items()
    }
    # A few scenes are named, many are counted.
    if 0 < len(scenes) < 4:
        for name, row in best.items():
            if equals[name]:
                others = ", ".join(f"**{policy}**" for policy in equals[name])
                text = f"On {name}, {_words(row)} is not clearly better than {others}"
                # Few seeds leave much open, even beside a policy that fails.
                few = all(scenes[name][policy].get("seeds", 5) < 5 for policy in equals[name])
                yield "", text + (", whose few training seeds differ." if few else ".")
            else:
                yield "good", f"On {name}, {_words(row)} is best{_against(row, scenes[name])}."
    elif scenes:
        wins: dict[str, list[str]] = {}
        for name, row in best.items():
            wins.setdefault("" if equals[name] else row["policy"], []).append(name)
        unclear = len(wins.pop("", ()))
        if unclear:
            yield "", f"On {unclear} of {len(scenes)} scenes no policy is clearly the best."
        if not wins:
            return
        ordered = sorted(wins.items(), key=lambda item: -len(item[1]))
        texts = [
            f"**{policy}** on {len(names)}" + (f" ({', '.join(names)})" if at else "")
            for at, (policy, names) in enumerate(ordered)
        ]
        yield "good", f"Clearly the best: {'; '.join(texts)}, of {len(scenes)} scenes."
        if (ratio := _ratio(scenes, ordered[0][0])) is not None:
            yield "good", ratio
    for name, scene_rows in by_scene(rows).items():
        if len(scene_rows) == 1:
            (row,) = scene_rows.values()
            yield "", f"On {name}, {_words(row)} played alone."


def _is_better(row: Row, other: Row, scene: str, gaps: Gaps) -> bool:
    """Return whether a policy is clearly better, by the test on the same episodes if there is one.

    Without it, intervals must not overlap.
    """
    first, second = row["policy"], other["policy"]
    if _is_above(row["success"], other["success"]["high"]):
        return True
    if (gap := gaps.get((scene, second, first))) is not None:
        return _is_above(gap, 0.0)
    if (gap := gaps.get((scene, first, second))) is not None:
        return gap["high"] is not None and gap["high"] < 0
    mine, theirs = row[VARIATION], other[VARIATION]
    return bool(mine and theirs) and _is_above(theirs, mine["high"])


def _words(row: Row) -> str:
    variation = row[VARIATION]
    text = f"success {percent(row['success']['mean'])}"
    if variation:
        text += f", pitch variation {variation['mean']:.2f} rad"
    return f"**{row['policy']}** ({text})"


def _against(best: Row, scene_rows: Mapping[str, Row]) -> str:
    """Return how much better the best is than the second best, and than the ruler."""
    others = sorted((row for row in scene_rows.values() if row is not best), key=rank)
    ruler = scene_rows.get(RULER, others[-1])
    rivals = [others[-1]] + [ruler] * (ruler is not others[-1] and ruler is not best)
    less = [
        f"{name} reached the finish in {percent(other['success']['mean'])}"
        for other in rivals
        if (name := f"**{other['policy']}**") and best["success"]["mean"] > other["success"]["mean"]
    ]
    if less:
        return f"; {' and '.join(less)}"
    means = [(row["policy"], row[VARIATION]["mean"]) for row in rivals if row[VARIATION]]
    if not best[VARIATION]:
        return ""
    mine = best[VARIATION]["mean"]
    texts = [
        f"{100 * (1 - mine / theirs):.0f} % less than **{name}** ({theirs:.2f} rad)"
        for name, theirs in means
        if theirs
    ]
    return f", with {' and '.join(texts)}" if texts else ""


def _ratio(scenes: Mapping[str, Mapping[str, Row]], policy: str) -> str | None:
    """Return the mean ratio of a policy's pitch variation to the ruler's."""
    pairs = [
        (scene_rows[policy], scene_rows[RULER])
        for scene_rows in scenes.values()
        if {policy, RULER} <= scene_rows.keys()
    ]
    whole = [
        (first[VARIATION]["mean"], second[VARIATION]["mean"])
        for first, second in pairs
        if all(row["success"]["mean"] == 1 and row[VARIATION] for row in (first, second))
    ]
    if policy == RULER or not whole or min(min(pair) for pair in whole) <= 0:
        return None
    mean = math.exp(float(np.mean([math.log(first / second) for first, second in whole])))
    return (
        f"On {counted(len(whole), 'scene')} that both always cross, the pitch variation of "
        f"**{policy}** is {mean:.2f} of that of **{RULER}** (geometric mean)."
    )


def _losses(rows: Sequence[Row], gaps: Gaps) -> Iterator[tuple[str, str]]:
    """Yield where policies are clearly worse than the ruler.

    By the difference on the same episodes where the results have it, else by the intervals.
    """
    # Paired differences decide, and intervals where the results have none.
    worse, compared = [], False
    for scene, scene_rows in by_scene(rows).items():
        ruler = scene_rows.pop(RULER, {})
        for policy, row in scene_rows.items() if ruler else ():
            compared = True
            variation, still = row[VARIATION], ruler[VARIATION]
            gap = gaps.get((scene, policy, RULER))
            name = f"**{policy}** on {scene}"
            intervals = (gap, 0.0) if gap or not still else (variation, still["high"])
            rocks, means = _is_above(*intervals), variation and still  # of what all seeds reached
            if _is_above(ruler["success"], row["success"]["high"]) or (rocks and not means):
                worse.append(f"{name} (success {percent(row['success']['mean'])})")
            elif rocks:
                worse.append(f"{name} ({variation['mean']:.2f} rad, not {still['mean']:.2f})")
    if worse:
        yield "bad", f"Worse than **{RULER}**, flippers held still: {'; '.join(worse)}."
    elif compared:
        yield "good", f"No policy is clearly worse than **{RULER}**, flippers held still."


def _is_above(interval: Mapping[str, Any] | None, limit: float | None) -> bool:
    low: float | None = interval["low"] if interval else None
    return low is not None and limit is not None and low > limit


def _failed(rows: Sequence[Row]) -> Iterator[tuple[str, str]]:
    counts: dict[str, dict[str, int]] = {}
    for row in rows:
        outcomes = counts.setdefault(row["policy"], {})
        for outcome, number in row["counts"].items():
            outcomes[outcome] = outcomes.get(outcome, 0) + number
    total = sum(sum(outcomes.values()) for outcomes in counts.values())
    failed = {
        policy: [(o, n) for o, n in outcomes.items() if n and o != Outcome.REACHED]
        for policy, outcomes in counts.items()
    }
    number = sum(n for outcomes in failed.values() for _, n in outcomes)
    # Without a failure there is one sentence, and none for a single episode.
    if not number:
        if total > 1:
            yield "good", f"All {total:,} episodes reached the finish{for_each_seed(rows)}."
        return
    texts = [
        f"**{policy}** {sum(n for _, n in outcomes)}"
        f" ({', '.join(f'{n} {outcome}' for outcome, n in outcomes)})"
        for policy, outcomes in failed.items()
        if outcomes
    ]
    words = f"{number:,} of {total:,} episodes failed{for_each_seed(rows)}"
    yield "bad", f"{words}: {', '.join(texts)}."
