"""Success, measures and risk of a policy, and its differences from baselines, as plain data.

In: the episodes of policies on one scene. Out: what ``eval --json`` has of the scene; how well a
policy's risk announces failures: in time, in vain, and how far as a probability.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Outcome
from flipperctl.env.metrics import CORE, with_both_names
from flipperctl.evaluation.conditions import numbered
from flipperctl.evaluation.evaluate import Played, Result
from flipperctl.evaluation.names import names as short_names
from flipperctl.evaluation.rows import Episodes, Row, reached
from flipperctl.evaluation.seeds import (
    SeedSamples,
    difference_interval,
    mean_interval,
    success_difference,
    success_interval,
)
from flipperctl.evaluation.statistics import holm, interval, paired_success, proportion
from flipperctl.rollout.episode import SEARCH
from flipperctl.rollout.risks import AHEAD, Ended, EpisodeRisks, agreement
from flipperctl.text.messages import percent
from flipperctl.text.show import NONE

Document = dict[str, Any]
_MEASURED = tuple(name for name in (*CORE[1:], CORE[0]) if name != "max_pitch")
"""Measures over the episodes that reached the finish alone."""
_COMPARED = ("t_cost", "pitch_variation_decisions", "pitch_variation_100hz")
VARIATION = "pitch variation [rad]"  # heading of the first figure, θ̂_R at 100 Hz
ROLLS = "roll_variation_decisions", "roll_variation_100hz"
"""Measures beside the pitch variations where the engine is 3-D."""


def _rolls(rows: Iterable[Row]) -> tuple[str, ...]:
    """Return ``ROLLS`` if every row is of an engine in 3-D, else nothing."""
    return ROLLS if all(name in row for row in rows for name in ROLLS) else ()


def baselines(terrain: str, episodes: Episodes, others: Mapping[str, Episodes]) -> Document:
    """Return the entry ``baseline``, the first one, and ``baselines`` if there are several."""
    compared = [
        {
            "controller": label,
            **summary(terrain, played),
            "difference": difference(episodes, played),
        }
        for label, played in others.items()
        if episodes.paired(played)
    ]
    first = {"baseline": compared[0]} if compared else {}
    return first | ({"baselines": compared} if len(compared) > 1 else {})


def compared(scene: Mapping[str, Any]) -> list[Document]:
    """Return the baselines of a scene in a document."""
    first = [scene["baseline"]] if "baseline" in scene else []
    return list(scene.get("baselines", first))


def summary(terrain: str, episodes: Episodes) -> Document:
    """Return the summary of a policy's episodes on a terrain, and of each kind of a mix."""
    parts = {label: _summary(label, part) for label, part in episodes.kinds().items()}
    return _summary(terrain, episodes) | ({"parts": parts} if parts else {})


def _summary(terrain: str, episodes: Episodes) -> Document:
    good, failed = episodes.reached, episodes.failed
    counts = Counter(row["outcome"] for row in episodes)
    success = proportion(len(good), len(episodes))
    document: Document = {
        "terrain": terrain,
        "episodes": len(episodes),
        "success_rate": success.mean,
        "success": success.to_dict(),
        "outcomes": {str(outcome): counts[outcome] for outcome in Outcome},
    }
    # Most measures compare crossings, and are means over the episodes that reached the finish.
    for name in _MEASURED:
        document[name] = estimate(good.values(name))
    for measure in episodes.measures():
        name = measure.plugin_name
        document[name] = estimate((good if measure.reached_only else episodes).values(name))
    # Parts that only some evaluations have
    if any("crossed_by" in row for row in episodes):
        document["passable"] = _passable(episodes)
    document["not_reached"] = _not_reached(failed)
    document["max_pitch"] = estimate(episodes.values("max_pitch"))
    document["return"] = estimate(episodes.values("return"))
    # What searches and risks tell, for policies that have them
    if search := _search(episodes):
        document["search"] = search
    risks = [(EpisodeRisks.pop(dict(row)), not reached(row)) for row in episodes]
    risk_summary = summarise([(risk, fails) for risk, fails in risks if risk is not None])
    if risk_summary is not None:
        document["risk"] = risk_summary
    return with_both_names(document)


def estimate(values: Sequence[float]) -> Document | None:
    """Return the mean, interval and range of (K,) values; None without values."""
    if not values:
        return None
    return interval(values).to_dict() | {"range": float(max(values) - min(values))}


def _passable(episodes: Episodes) -> Document:
    """Return the success over the episodes that a reference crosses.

    An episode that no reference crosses is no evidence against the policy.
    """
    fair = episodes.where(lambda row: bool(row.get("crossed_by")))
    beyond = sum(reached(row) for row in episodes if not row.get("crossed_by"))
    if not fair:
        return {"episodes": 0, "success_rate": None, "success": None, "beyond": beyond}
    success = proportion(len(fair.reached), len(fair))
    rates = {"success_rate": success.mean, "success": success.to_dict()}
    return {"episodes": len(fair), **rates, "beyond": beyond}


def _not_reached(failed: Episodes) -> Document | None:
    """Return the measures over the episodes that did not reach the finish, until their end."""
    if not failed:
        return None
    names = {"duration": "t_cost"} | {name: name for name in _MEASURED[1:]}
    names |= {m.plugin_name: m.plugin_name for m in failed.measures() if m.reached_only}
    values = {key: estimate(failed.values(name)) for key, name in names.items()}
    return with_both_names({"episodes": len(failed), **values})


def _search(episodes: Episodes) -> Document:
    """Return the mean of each number that searches reported, and the counts of each word."""
    document: Document = {}
    for key in [name for name in episodes[0] if name.startswith(SEARCH)]:
        values: list[Any] = episodes.values(key)
        words = Counter(value for value in values if isinstance(value, str))
        mean = None if words else sum(values) / len(values)
        document[key.removeprefix(SEARCH)] = dict(words.most_common()) if words else mean
    return document


def difference(episodes: Episodes, baseline: Sequence[Row]) -> Document:
    """Return the mean differences of success and measures to a baseline at equal seeds."""
    pairs = {label: part.paired(baseline) for label, part in episodes.kinds().items()}
    parts = {label: _difference(pair_rows) for label, pair_rows in pairs.items() if pair_rows}
    return _difference(episodes.paired(baseline)) | ({"parts": parts} if parts else {})


def _difference(pairs: Sequence[tuple[Row, Row]]) -> Document:
    # Success in pairs, then each measure where both have it
    won = sum(reached(mine) and not reached(other) for mine, other in pairs)
    lost = sum(reached(other) and not reached(mine) for mine, other in pairs)
    names = dict.fromkeys(_COMPARED, True)
    shared = Episodes(tuple(row for pair in pairs for row in pair)).measures()
    names |= {measure.plugin_name: measure.reached_only for measure in shared}
    gaps: Document = {"success": paired_success(won, lost, len(pairs)).to_dict()}
    for name, only_reached in names.items():
        values = [
            mine[name] - other[name]
            for mine, other in pairs
            if name in mine and name in other
            if not only_reached or (reached(mine) and reached(other))
        ]
        gap = interval(values).to_dict() | {"episodes": len(values)} if values else None
        gaps[name] = gap
    return with_both_names(gaps)


def correct(scenes: Sequence[Document]) -> None:
    """Correct the p-values of success of all baselines of documents that are shown together."""
    correct_all(baseline["difference"] for scene in scenes for baseline in compared(scene))


def correct_all(differences: Iterable[Document]) -> None:
    """Correct the p-values of success of differences that are shown together (Holm 1979)."""
    gaps = (
        difference for gap in differences for difference in (gap, *gap.get("parts", {}).values())
    )
    tests = [difference["success"] for difference in gaps]
    for test, p in zip(tests, holm([other["p"] for other in tests]), strict=True):
        test["p_holm"] = p


def named(evaluated: Document) -> list[tuple[str, Document]]:
    """Return each scene with its name; scenes on equal episodes share it.

    The name is the one within the suite, or the terrain. Several scenes of a terrain also have what
    tells them apart: conditions, engine, sensor, or the hash of all. Scenes of one policy that are
    equal in all of these, such as several of its settings, are numbered.
    """
    scenes = evaluated["scenes"]
    # Scenes on equal episodes have one key, and so one name.
    keys = [(s.get("suite_scene", ""), s["terrain"], s["conditions"]["hash"]) for s in scenes]
    distinct = {key: scene["conditions"] for key, scene in zip(keys, scenes, strict=True)}
    several = len({suite for suite, _, _ in distinct}) > 1
    names = {}
    # Only what tells scenes of one terrain apart stands in their names.
    for key, conditions in distinct.items():
        suite, terrain, _ = key
        alike = [c for (s, t, _), c in distinct.items() if (s, t) == (suite, terrain)]
        words, *words_of_alike = (
            (c["name"], c["sim"]["name"], c["perception"]["name"]) for c in (conditions, *alike)
        )
        telling = [
            text for at, text in enumerate(words) if len({c[at] for c in words_of_alike}) > 1
        ]
        telling += [] if len(set(words_of_alike)) == len(alike) else [conditions["hash"]]
        names[key] = ", ".join([terrain, *telling, *([suite] if several and suite else [])])
    texts = [names[key] for key in keys]
    if not any("method" in scene for scene in scenes):
        texts = numbered(texts)
    return list(zip(texts, scenes, strict=True))


# Methods pooled over their training seeds, with intervals over seeds and episodes


def key_of(scene: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return what tells a method on a scene in a document from others."""
    names = (scene.get("suite_scene", ""), scene["terrain"], scene.get("method", ""))
    return *names, scene["conditions"]["hash"], scene["seed"]


def pooled(result: Result) -> list[dict[str, Any]]:
    """Return the summary of each method with several training seeds on each scene."""
    groups: dict[tuple[Any, ...], list[Played]] = {}
    for item in result.rows:
        if item.entry.training_seed is not None:
            groups.setdefault((item.entry.ground, item.entry.method), []).append(item)
    return [_pool(result, group) for group in groups.values() if len(group) > 1]


def _pool(result: Result, group: Sequence[Played]) -> dict[str, Any]:
    # Episodes that all seeds played, so that seeds and episodes cross
    entry = group[0].entry
    table = _shared(group)
    method = _method(entry.method, table)
    success = success_interval(method)
    counts = Counter(row["outcome"] for rows in table for row in rows)
    rolls = _rolls(row for rows in table for row in rows)
    crossed = [(name, _crossed(table, name)) for name in (*_MEASURED, *rolls)]
    conditions = entry.conditions
    return {
        "terrain": entry.terrain,
        **{name: text for name, text in entry.names.items() if name != "training_seed"},
        "seeds": len(group),
        "episodes": len(table[0]),
        "success_rate": success.mean,
        "success": success.to_dict(),
        "outcomes": {str(outcome): counts[outcome] for outcome in Outcome},
        **{name: None if v is None else mean_interval({"": v}).to_dict() for name, v in crossed},
        "seed": entry.config.eval.seed,
        "conditions": {"name": conditions.name, "hash": conditions.hash},
        "baselines": [
            {"controller": other.entry.label, "difference": _pooled_difference(group, other)}
            for other in result.baselines(group[0])
        ],
    }


def _shared(group: Sequence[Played]) -> list[list[Row]]:
    """Return the episodes that all played, in the same order: a list for each of the S seeds."""
    rows = [{row["seed"]: row for row in item.episodes} for item in group]
    shared = [seed for seed in rows[0] if all(seed in other for other in rows)]
    return [[seed_rows[seed] for seed in shared] for seed_rows in rows]


def _method(name: str, table: Sequence[Sequence[Row]]) -> SeedSamples:
    good = np.array([[reached(row) for row in rows] for rows in table])
    return SeedSamples(name, {"": np.zeros(good.shape)}, {"": good})


def _crossed(table: Sequence[Sequence[Row]], name: str) -> FloatArray | None:
    """Return a measure over the episodes that every seed reached, (S, E); None without any."""
    crossed = [rows for rows in zip(*table, strict=True) if all(map(reached, rows))]
    return np.array([[row[name] for row in rows] for rows in crossed]).T if crossed else None


def _pooled_difference(group: Sequence[Played], other: Played) -> dict[str, Any]:
    """Return the method minus a baseline on the same episodes; measures where all reached."""
    table = _shared([*group, other])
    method, baseline = _method("", table[:-1]), _method("", table[-1:])
    success, p = success_difference(method, baseline)
    gaps: dict[str, Any] = {"success": success.to_dict() | {"p": p, "p_holm": p}}
    for name in (*_COMPARED, *_rolls(row for rows in table for row in rows)):
        v = _crossed(table, name)
        gap = None if v is None else difference_interval({"": v[:-1]}, {"": v[-1:]})[0]
        gaps[name] = gap and gap.to_dict()
    return with_both_names(gaps)


# How a policy's risk fits the ends of its episodes


def risk_text(*risks: Mapping[str, Any]) -> str:
    """Return the counts of summaries, all of one threshold, in one sentence."""
    names = "failures", "announced", "reached", "false_alarms"
    failures, announced, reached, alarms = (sum(risk[n] for risk in risks) for n in names)
    warned = f"warned {AHEAD} or more decisions before {announced:.0f} of {failures:.0f} failures"
    return (
        f"{warned if failures else 'no failure to announce'}; false alarms in "
        f"{alarms:.0f} of {reached:.0f} successes (risk of "
        f"{risks[0]['threshold']:.2g} or more within {risks[0]['horizon']:.0f} decisions)"
    )


def summarise(episodes: Sequence[Ended]) -> Document | None:
    """Return ``agreement`` with the rates of its counts and their intervals; None without episodes.

    Rates are ``announced_rate`` of the failures and ``false_alarm_rate`` of the reached episodes.
    """
    if not episodes:
        return None
    shares = {
        "announced": ("announced_rate", "failures"),
        "false_alarms": ("false_alarm_rate", "reached"),
    }
    document: Document = {}
    counts = agreement(episodes)
    for name, value in counts.items():
        document[name] = value
        if name in shares:
            rate, whole = shares[name]
            document[rate] = proportion(value, counts[whole]).to_dict() if counts[whole] else None
    return document


# Texts


def shown_names(evaluated: Document) -> Mapping[str, str]:
    """Return the names of policies, of methods of several seeds and of baselines by label."""
    scenes = evaluated["scenes"]
    labels = [scene.get("method") or scene["controller"] for scene in scenes]
    labels += [other["controller"] for scene in scenes for other in compared(scene)]
    return short_names(labels)


def rate_text(summarised: Mapping[str, Any]) -> str:
    """Return a rate in percent with its interval, ``[–]`` where it has none."""
    low, high = summarised["low"], summarised["high"]
    ends = NONE if low is None or high is None else f"{100 * low:.3g}, {100 * high:.3g}"
    return f"{percent(summarised['mean'])} [{ends}]"


def p_text(p: float) -> str:
    """Return a p-value with three decimals."""
    return "<0.001" if p < 0.001 else f"{p:.3f}"


def gap_text(success: Mapping[str, Any], of: int = 1) -> str:
    """Return a difference of success in percent, with its p-value where it is not 0.

    ``of``: of how many differences the p-value is corrected.
    """
    mean, p = success["mean"], success["p_holm"]
    holm_of = f", Holm of {of}" if of > 1 else ""
    return "±0" if mean == 0 else f"{100 * mean:+.3g} % (p {p_text(p)}{holm_of})"
