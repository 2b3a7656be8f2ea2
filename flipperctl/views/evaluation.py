"""The document and the tables of ``flipperctl eval``.

In: the result of an evaluation, and names of drawn numbers (``--by``). Out: the document of
``eval --json``, whose numbers are plain data, and from such a document the tables of the terminal,
``table.csv`` and ``table.tex``.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from flipperctl.api import Outcome
from flipperctl.config import EvalConfig
from flipperctl.config.words import check_different
from flipperctl.env.ground import generate_profile
from flipperctl.env.metrics import heading, measures, other_measures
from flipperctl.errors import RequestError
from flipperctl.evaluation.evaluate import Played, Result
from flipperctl.evaluation.plan import is_best_known
from flipperctl.evaluation.rows import Episodes, Row
from flipperctl.text.messages import broken_hint, close_match, counted, unknown
from flipperctl.text.show import Column, Table, console, print_lines, print_table, print_text
from flipperctl.views import engines, summary
from flipperctl.views.published import published
from flipperctl.views.summary import (
    VARIATION,
    Document,
    baselines,
    compared,
    correct,
    gap_text,
    named,
    rate_text,
    shown_names,
)

_ROLL_GAP = Column("roll", "Δ roll variation [rad]", sign="+")
_LINES = 6  # largest number of differences that are lines; more are a table
_TRIES = 100  # number of profiles in which a name is looked for before the evaluation
_STARTS = ("start_shift", "start_front", "start_rear")
Names = tuple[str, ...]
"""Drawn numbers whose combinations are groups, such as length, height, slope or friction."""
ROLL = Column("roll_variation_100hz", "roll variation [rad]")
"""Column beside the pitch variation where the engine is 3-D."""
_SUCCESS = Column("success_text", "success")
_LATEX = r"Pitch variation $\hat\theta_R$ [rad]"
_PITCH = Column("pitch_variation_100hz", VARIATION, latex=_LATEX)
_SCENE, _POLICY = (Column(name, name, named=True) for name in ("scene", "policy"))


def document(result: Result, by: Sequence[Names] = ()) -> Document:
    """Return the results as plain data, without individual episodes.

    ``by``: numbers whose combinations are groups.
    """
    scenes = []
    # Each scene with its baselines, and the causes of its failures
    for item in result.rows:
        entry, others = item.entry, {o.entry.label: o.episodes for o in result.baselines(item)}
        numbers = summary.summary(entry.terrain, item.episodes)
        if result.references and "passable" in numbers:
            numbers["passable"]["references"] = list(result.references)
        causes = Counter(row["failed_by"] for row in item.episodes if "failed_by" in row)
        scenes.append(
            {
                **numbers,
                "controller": entry.label,
                "seed": entry.config.eval.seed,
                "conditions": entry.conditions.to_dict(),
                **({"failed_by": dict(causes.most_common())} if causes else {}),
                **entry.names,
                **baselines(entry.terrain, item.episodes, others),
            }
        )
    correct(scenes)
    # Groups are corrected among themselves, as they are shown together.
    if by:
        for scene, item in zip(scenes, result.rows, strict=True):
            rivals = result.baselines(item)
            scene["by"] = {"+".join(names): list(_groups(item, rivals, names)) for names in by}
        correct([group for scene in scenes for part in scene["by"].values() for group in part])
    methods = summary.pooled(result)
    correct(methods)
    result_document: Document = {
        "controller": ", ".join(dict.fromkeys(o.entry.label for o in result.rows))
    }
    # What is missing, and why
    if (stopped := result.interruption) is not None:
        result_document |= {
            "interrupted": True,
            "finished_episodes": stopped.finished,
            "planned_episodes": stopped.planned,
            "not_begun": list(stopped.not_begun),
        }
    if result.failures:
        result_document["failed"] = [
            {
                "controller": failure.controller,
                "terrain": failure.terrain,
                "error": str(failure.error),
            }
            for failure in result.failures
        ]
    result_document["scenes"] = scenes
    if methods:
        result_document["methods"] = methods
    if result.plan.engines:
        result_document["engines"] = engines.document(result)
    return result_document


def parse_groups(text: str | None, option: str, configs: Sequence[EvalConfig]) -> list[Names]:
    """Return the names in ``steps,slope+up``: a list of tables, each by one or several numbers."""
    if text is None:
        return []
    groups = [tuple(name.strip() for name in part.split("+")) for part in text.split(",")]
    if not all(all(names) and len(set(names)) == len(names) for names in groups):
        raise RequestError(f"{option}: names as in steps,slope+up are allowed; got {text!r}")
    check_different(f"{option} {text}", ["+".join(sorted(names)) for names in groups])
    # A few profiles show what a terrain draws; a name must be among it.
    for name in dict.fromkeys(name for names in groups for name in names):
        known: dict[str, None] = {}
        for config in configs:
            rng = np.random.default_rng(0)
            known |= dict.fromkeys([*_STARTS, *config.sample(rng)])
            for _ in range(_TRIES):
                if name not in known:
                    known |= dict.fromkeys(generate_profile(config.terrain, rng, 1.0).drawn)
            if name in known:
                break
        else:
            raise RequestError(unknown(f"{option}: no scene draws", name, known))
    return groups


def _groups(item: Played, others: Sequence[Played], names: Names) -> Iterator[dict[str, Any]]:
    terrain = item.entry.terrain
    for ranges, episodes in item.episodes.binned(names):
        paired = {
            other.entry.label: Episodes(tuple(row for _, row in episodes.paired(other.episodes)))
            for other in others
        }
        yield {
            "drawn": {name: {"low": low, "high": high} for name, (low, high) in ranges.items()},
            **summary.summary(terrain, episodes),
            **baselines(terrain, episodes, paired),
        }


# Tables of a document


def tables(evaluated: Document, title: str, columns: Sequence[str] = ()) -> Iterator[Table]:
    """Yield the table of policies, of differences if they are many, and a table for each group.

    ``title`` names what was evaluated; ``columns``: further ones, of ``known_columns``.
    """
    table = policies(evaluated, title, columns)
    rows = list(difference_rows(evaluated, "scene" in {column.key for column in table.columns}))
    # Their p-values are corrected together, those of each part of the episodes included.
    tested = [other for *_, scene in _policies(evaluated) for other in compared(scene)]
    of = sum(1 + len(other["difference"].get("parts", ())) for other in tested)
    # A few differences are sentences below the table; many are a table of their own.
    if 0 < len(rows) <= _LINES and not any(row["scene"] for row in rows):
        several = len({row["policy"] for row in rows}) > 1
        table.notes += [_sentence(row, several=several, of=of) for row in rows]
    yield table
    if rows and not table.notes:
        head = [
            *([_SCENE] if any(row["scene"] for row in rows) else []),
            _POLICY,
            Column("against", "against", named=True),
            Column("variation", "Δ pitch variation [rad]", sign="+"),
            *([_ROLL_GAP] if any(row[_ROLL_GAP.key] for row in rows) else []),
            Column("success_text", f"Δ success (p, Holm of {of})"),
        ]
        shown = [row | {"success_text": gap_text(row["success"])} for row in rows]
        yield Table(head, list(_without_repeats(shown)), "Differences on the same episodes")
    # Groups, engines and published results follow, where there are any.
    called = shown_names(evaluated)
    for name, scene in named(evaluated):
        yield from group_tables(name, scene, called[scene.get("method") or scene["controller"]])
    yield from engines.tables(evaluated.get("engines", ()))
    if papers := published(evaluated):
        yield papers


def policies(evaluated: Document, title: str, columns: Sequence[str] = ()) -> Table:
    """Return a row for each policy and baseline on each scene, methods pooled over their seeds."""
    rows = list(policy_rows(evaluated))
    # Names that would be the same in every row are left out.
    scenes = dict.fromkeys(row["scene"] for row in rows)
    single = len(scenes) == 1 and not any(row.get("dim") for row in rows)
    several = len({row["policy"] for row in rows}) > 1 or any(
        earlier["scene"] == other["scene"] for earlier, other in pairwise(rows)
    )
    counts = dict.fromkeys(
        counted(row["episodes"], "episode") for row in rows if not row.get("dim")
    )
    # Further columns: those that were asked for, and the number of episodes where it differs
    wanted_names = {*columns, "episodes"} if len(counts) > 1 else {*columns}
    further = [
        column
        for name, column in known_columns().items()
        if name in wanted_names and any(row.get(column.key) not in (None, "") for row in rows)
    ]
    timed = any(column.key == "t_cost" for column in further)  # which has the interval as well
    columns_if = {
        _SCENE: not single,
        _POLICY: several,
        _SUCCESS: True,
        Column("failures", "failures", named=True): any(row["failures"] for row in rows),
        Column("passable_text", "of passable"): any(row["passable_text"] for row in rows),
        _PITCH: True,
        ROLL: any(row.get(ROLL.key) is not None for row in rows),
        Column("time", "time [s]", 1): not timed,
    }
    head = [column for column, wanted in columns_if.items() if wanted]
    keys = {column.key for column in head}
    head += [column for column in further if column.key not in keys]
    # The title says what the columns leave out.
    parts = [title, *([next(iter(scenes))] if single else [])]
    text = " on ".join(part for part in dict.fromkeys(parts) if part)
    if evaluated.get("interrupted"):
        finished, planned = evaluated["finished_episodes"], evaluated["planned_episodes"]
        text += f" (interrupted: {finished} of {planned} episodes)"
    shown = rows if single else list(_without_repeats(rows))
    if len(counts) == 1:
        text += f" · {', '.join(counts)}{' of each seed' * any('seeds' in row for row in rows)}"
    return Table(head, shown, text)


def _without_repeats(rows: Sequence[Row]) -> Iterator[Row]:
    """Yield the rows with the name of a scene in the first one alone."""
    last = None
    for row in rows:
        repeated, dim = row["scene"] == last, row.get("dim")
        last = last if dim else row["scene"]
        scene = "" if repeated else row["scene"]
        yield row | {"scene": scene, "line": not repeated and not dim}


def _policies(evaluated: Document) -> Iterator[tuple[str, str, Document]]:
    """Yield scene, policy and numbers of each policy; a method is pooled over its seeds."""
    methods = {summary.key_of(method): method for method in evaluated.get("methods", ())}
    called, shown = shown_names(evaluated), set[object]()
    for name, scene in named(evaluated):
        key = summary.key_of(scene)
        pooled = methods.get(key) if "training_seed" in scene else None
        if pooled is None or key not in shown:
            yield name, called[scene.get("method") or scene["controller"]], pooled or scene
        shown.add(key)


def policy_rows(evaluated: Document) -> Iterator[Row]:
    """Yield the rows of the table of policies; parts of a mix are dim."""
    for name, policy, numbers in _policies(evaluated):
        seeds = f" ({numbers['seeds']} seeds)" if "seeds" in numbers else ""
        yield _row(name, f"{policy}{seeds}", numbers)
        for part, inner in numbers.get("parts", {}).items():
            yield _row(f"  {part}", policy, inner) | {"dim": True}
        if "method" not in numbers:  # else they have rows of their own
            for other in compared(numbers):
                yield _row(name, other["controller"], other)


def _row(name: str, policy: str, scene: Document) -> Row:
    passable = (scene.get("passable") or {}).get("success")
    outcomes = scene.get("outcomes", {})
    failures = [f"{n} {name}" for name, n in outcomes.items() if n and name != Outcome.REACHED]
    failures += [f"by {cause} {n}" for cause, n in scene.get("failed_by", {}).items()]
    return {
        **scene,
        "scene": name,
        "policy": policy,
        "time": (scene["t_cost"] or {}).get("mean"),
        "success_text": rate_text(scene["success"]),
        "failures": ", ".join(failures),
        "passable_text": rate_text(passable) if passable else "",
        "counts": outcomes,
        "outcomes": " ".join(f"{name} {n}" for name, n in outcomes.items() if n),
        "not_reached_variation": (scene.get("not_reached") or {}).get("pitch_variation_100hz"),
        "search": _search_text(scene.get("search", {})),
    }


def _search_text(search: Mapping[str, Any]) -> str:
    parts = []
    for key, value in search.items():
        counts = value.items() if isinstance(value, Mapping) else ()
        words = ", ".join(f"{word} {count}" for word, count in counts)
        parts.append(f"{key} {words}" if words else f"{key} {value:.6g}")
    return "; ".join(parts)


_OPTIONAL = {
    "success_rate": _SUCCESS,
    "pitch_variation_100hz": _PITCH,
    "decisions": Column("decisions", "decisions", 1),
    "episodes": Column("episodes", "episodes"),
    "outcomes": Column("outcomes", "outcomes", named=True),
    "return": Column("return", "return"),
    "not_reached": Column("not_reached_variation", "pitch variation where not reached [rad]"),
    "search": Column("search", "search", named=True),
}
"""Columns that ``--columns`` names; the first two always stand in the table of policies."""


def known_columns() -> dict[str, Column]:
    """Return the columns that ``--columns`` chooses, by name, all measures included."""
    further = {k: Column(k, heading(type(m)), m.digits) for k, m in measures().items()}
    return {**further, **_OPTIONAL}


def parse_columns(text: str | None) -> list[str]:
    """Return the names of ``--columns``; ``all`` stands for every one."""
    names = [] if text is None else [name.strip() for name in text.split(",")]
    known = known_columns()
    if names == ["all"]:
        return list(known)
    for name in names:
        if name not in known:
            raise RequestError(
                f"--columns: there is no column {name!r}"
                f"{close_match(name, known) or broken_hint()}; known: all, {', '.join(known)}"
            )
    return list(dict.fromkeys(names))


def difference_rows(evaluated: Document, with_scene: bool = True) -> Iterator[Row]:
    """Yield a row for each difference of a policy to a baseline."""
    for name, policy, scene in _policies(evaluated):
        for other in compared(scene):
            yield {
                "scene": name if with_scene else "",
                "policy": policy,
                "against": other["controller"],
                "seeds": scene.get("seeds", 1),
                "variation": other["difference"]["pitch_variation_100hz"],
                "roll": other["difference"].get(ROLL.key),
                "success": other["difference"]["success"],
            }


def _sentence(row: Row, *, several: bool, of: int) -> str:
    who = "both" if row["seeds"] == 1 else f"{row['against']} and every seed"
    text = f"no episode that {who} reach" if row["variation"] is None else _gap(row["variation"])
    if row["roll"] is not None:
        text += f", roll variation {_gap(row['roll'])}"
    who = f"{row['policy']} against {row['against']}" if several else f"against {row['against']}"
    success = gap_text(row["success"], of)
    return f"{who}, same episodes: pitch variation {text}, success {success}"


def _gap(gap: Mapping[str, Any]) -> str:
    low, high = gap["low"], gap["high"]
    ends = "" if low is None else f" [{low:+.2f}, {high:+.2f}]"
    return f"{gap['mean']:+z.2f} rad{ends}"


def group_tables(name: str, scene: Mapping[str, Any], who: str) -> Iterator[Table]:
    """Yield success and differences to the baselines by numbers, in tables that say ``who``."""
    for by, groups in scene.get("by", {}).items():
        if groups:
            labels = dict.fromkeys(o["controller"] for group in groups for o in compared(group))
            head = [
                *(Column(f"drawn_{key}", key) for key in groups[0]["drawn"]),
                Column("episodes", "episodes"),
                Column("success_text", "success"),
                Column("pitch_variation_100hz", VARIATION),
                *([ROLL] if all(ROLL.key in group for group in groups) else []),
                *(Column(f"gap_{label}", f"Δ to {label} [rad]", sign="+") for label in labels),
            ]
            title = f"{who} on {name} by {by.replace('+', ' and ')}"
            yield Table(head, [_group_row(group) for group in groups], title)


def _group_row(group: Mapping[str, Any]) -> dict[str, Any]:
    ends = {name: (span["low"], span["high"]) for name, span in group["drawn"].items()}
    drawn = {
        f"drawn_{name}": f"{low:.4g}" if low == high else f"{low:.3g} to {high:.3g}"
        for name, (low, high) in ends.items()
    }
    gaps = {
        f"gap_{other['controller']}": other["difference"]["pitch_variation_100hz"]
        for other in compared(group)
    }
    return {**group, **drawn, **gaps, "success_text": rate_text(group["success"])}


def print_result(result: Result, evaluated: Document, columns: Sequence[str]) -> None:
    """Print the tables of a document, with further ``columns``, and the notes of its result."""
    for text in _alike(result):
        print_text(text, stderr=True)
    out = console()
    for at, table in enumerate(tables(evaluated, result.plan.title, columns)):
        if at:
            out.print()
        print_table(table, out)
    failures = engines.failure_lines(evaluated.get("engines", ()))
    more = "" if columns else " More columns: --columns all"
    lines = *failures, *_conditions(result), *_risks(evaluated), f"95 % intervals.{more}"
    print_lines(out, lines)


def _alike(result: Result) -> Iterator[str]:
    """Yield a line for each scene whose outcomes and measures are all identical, once for all."""
    names = ("outcome", "t_cost", "pitch_variation_100hz", "max_pitch", "return")
    hashes: set[str] = set()
    for item in result.rows:
        entry, count = item.entry, len(item.episodes)
        measured = {tuple(row[name] for name in names) for row in item.episodes}
        if count > 1 == len(measured) and not (entry.method and entry.conditions.hash in hashes):
            hashes.add(entry.conditions.hash)
            yield (
                f"{entry.terrain}: all {count} episodes are identical, since nothing is random; "
                "means have no interval (episode.start_noise, perception.noise, randomise or "
                "conditions=varied make episodes differ)"
            )


def _conditions(result: Result) -> Iterator[str]:
    """Yield a line for each set of conditions with a setting that is not the default."""
    scenes_of: dict[tuple[str, str], dict[str, None]] = {}
    for item in result.rows:
        entry = item.entry
        scene = f"{entry.terrain}, {entry.scene}" if entry.scene else entry.terrain
        conditions = entry.conditions.name, entry.conditions.line()
        scenes_of.setdefault(conditions, {})[scene] = None
    # Rows of conditions with names of their own need not be named again.
    varied = [(name, words) for name, words in scenes_of if words]
    for name, words in varied:
        text = f"conditions {name}: {words}"
        alone = len(varied) == 1 == [other for other, _ in scenes_of].count(name)
        yield text if alone else f"{'; '.join(scenes_of[name, words])}: {text}"


def _risks(evaluated: Document) -> Iterator[str]:
    """Yield a line for each policy that told its risk, on all of its scenes together."""
    called, by_policy = shown_names(evaluated), defaultdict[tuple[str, float], list[Document]](list)
    for scene in evaluated["scenes"]:
        if scene.get("risk"):
            who = called[scene.get("method") or scene["controller"]]
            by_policy[who, scene["risk"]["threshold"]].append(scene["risk"])
    for (who, _), risks in by_policy.items():
        yield f"risk, {who}: {summary.risk_text(*risks)}"


# Files


def csv_rows(evaluated: Document, digits: int | None = None) -> Iterator[Row]:
    """Yield the rows of ``table.csv``: one for each scene and policy, with the ends of intervals.

    ``digits``: decimals of the numbers; None leaves them as they are.
    """
    further = [m.plugin_name for m in other_measures()]
    names = ("success", "t_cost", "pitch_variation_100hz", "pitch_variation_decisions", "max_pitch")
    called = shown_names(evaluated)
    # The scene's own policy, then its baselines
    for scene in evaluated["scenes"]:
        method = scene.get("method", "")
        stored = is_best_known(method)
        others = [] if method else compared(scene)
        first = method if stored else scene["controller"]
        for label, numbers in ((first, scene), *((other["controller"], other) for other in others)):
            row: Row = {
                "scene": scene["terrain"],
                "method": method or called[label],
                "controller": label,
                "n": numbers["episodes"],
                "reached": numbers["outcomes"]["reached"],
            }
            for name in (*names, "flipper_travel", *(m for m in further if m in numbers)):
                row |= _ends(name, numbers[name], digits)
            failed = (numbers["not_reached"] or {}).get("pitch_variation_100hz")
            row |= _ends("not_reached_pitch_variation_100hz", failed, digits)
            rest = {n: scene[n] for n in ("suite_scene", "training_seed") if n in scene}
            conditions = scene["conditions"]
            hashed = {"conditions": conditions["name"], "conditions_hash": conditions["hash"]}
            yield {**row, "seed": scene["seed"], **hashed, **rest}


def _ends(name: str, interval: Mapping[str, Any] | None, digits: int | None) -> Row:
    """Return the mean and the ends of its interval, each None where there is none."""
    values = [None if interval is None else interval[end] for end in ("mean", "low", "high")]
    if digits is not None:
        values = [None if value is None else round(value, digits) for value in values]
    return dict(zip((name, f"{name}_low", f"{name}_high"), values, strict=True))
