"""A policy in several engines on the same episodes (``eval … sim=planar,mujoco``).

In: the result of an evaluation whose scenes are played in the default engine and in another one,
and there with a sensor if one maps the ground. Out: what is lost from one to the next, paired by
seed, and why the episodes of the last one failed. Friction, gravity, ground and start are equal.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from flipperctl.api import SharedSetting
from flipperctl.config import DEFAULT_ENGINE, EnvConfig, EvalConfig, resolver
from flipperctl.errors import ConfigError
from flipperctl.evaluation.evaluate import Played, Result
from flipperctl.evaluation.failure_causes import explain, on_true_ground
from flipperctl.evaluation.rows import CAUSE, END, Episodes, reached
from flipperctl.text.show import NONE, Column, Table
from flipperctl.views.summary import (
    Document,
    correct_all,
    difference,
    gap_text,
    short,
    summary,
)

Config = TypeVar("Config", bound=EnvConfig)
_SHARED: tuple[SharedSetting, ...] = ("friction", "gravity")
"""Settings that the default engine takes from the other one."""


def in_default_engine(config: Config) -> Config:
    """Return the configuration in the default engine, with the same friction and gravity."""
    sim = config.sim
    if sim.plugin_name == DEFAULT_ENGINE:
        return config
    # Friction and gravity must be equal for a comparison of engines.
    known = {name: sim.shared_setting(name) for name in _SHARED}
    shared: dict[str, Any] = {name: value for name, value in known.items() if value is not None}
    plane = resolver.create("sim", {"name": DEFAULT_ENGINE, **shared}, "sim")
    # A sampled setting that one engine lacks would make unequal episodes.
    sampled = (setting for setting in config.randomise.sampled() if setting.section == "sim")
    if foreign := [
        setting.key for setting in sampled if setting.field not in type(plane).model_fields
    ]:
        raise ConfigError(
            f"{', '.join(foreign)}: sim={DEFAULT_ENGINE}, the engine to compare with, has no such "
            f"setting; add {' '.join(f'{key}=null' for key in foreign)}"
        )
    return config.model_copy(update={"sim": plane})


def steps(config: EvalConfig) -> list[EvalConfig]:
    """Return the configurations that lead from the default engine to ``config``.

    With a sensor such as ``lidar``, both engines perceive the true ground, and the last step adds
    the sensor.
    """
    exact = on_true_ground(config)
    truly = config if exact is None else exact
    return [in_default_engine(truly), truly, *([] if exact is None else [config])]


def explained(result: Result) -> Result:
    """Return the result with the cause of each failure in the last step, found by playing again."""
    causes: dict[int, Played] = {}
    for group in _groups(result):
        first, last = group[0], group[-1]
        ends = {row["seed"]: row for row in first.episodes}
        rows = tuple(
            row if reached(row) else row | explain(last.entry.config, last.entry.source, row)
            for row in last.episodes
            if row["seed"] in ends
        )
        causes[id(last)] = replace(last, episodes=Episodes(rows))
    return replace(result, played=tuple(causes.get(id(item), item) for item in result.played))


def document(result: Result) -> list[Document]:
    """Return what each policy loses from engine to engine on each terrain, as plain data."""
    comparisons = [_document(group) for group in _groups(result)]
    sensed = [comparison["sensed"]["gap"] for comparison in comparisons if "sensed" in comparison]
    correct_all([*(comparison["gap"] for comparison in comparisons), *sensed])
    for comparison in comparisons:
        comparison["success_gap"] = comparison["gap"]["success"]
    return comparisons


def _groups(result: Result) -> Iterator[list[Played]]:
    """Yield the two or three steps of each policy on each terrain, if all were played."""
    groups: dict[int, list[Played]] = {}
    for item in result.played:
        if item.entry.comparison is not None:
            groups.setdefault(item.entry.comparison, []).append(item)
    for number, group in groups.items():
        planned = [e for e in result.plan.entries if e.comparison == number]
        whole = all(len(item.episodes) == len(group[0].episodes) for item in group)
        if len(group) == len(planned) and whole:
            yield group


def _document(group: Sequence[Played]) -> Document:
    first, second, *rest = group
    entry, last = second.entry, group[-1]
    # Failures of the last step, beside how the default engine ended the same episodes
    failed = [
        {
            **{name: row[name] for name in ("episode", "seed", "terrain", "outcome")},
            "cause": row[CAUSE],
            "default_outcome": before["outcome"],
            "time": row["t_cost"],
            **{name: row[column] for name, column in END.items()},
        }
        for row, before in last.episodes.failed.paired(first.episodes)
    ]
    counts = Counter(failure["cause"] for failure in failed).most_common()
    comparison: Document = {
        "terrain": entry.terrain,
        "controller": entry.label,
        "engines": [first.entry.sim, entry.sim],
        "seed": entry.config.eval.seed,
        "conditions": last.entry.conditions.to_dict(),
        first.entry.sim: summary(entry.terrain, first.episodes),
        entry.sim: summary(entry.terrain, second.episodes),
        "kept": _kept(first, second),
        "gap": difference(second.episodes, first.episodes),
        "causes": dict(counts),
        "failures": failed,
    }
    # A sensor that maps the ground makes a third step, in the same engine.
    for sensed in rest:
        comparison["sensed"] = {
            "sensor": sensed.entry.config.perception.plugin_name,
            "summary": summary(entry.terrain, sensed.episodes),
            "gap": difference(sensed.episodes, second.episodes),
            "kept": _kept(second, sensed),
        }
    return comparison


def _kept(first: Played, then: Played) -> float | None:
    """Return the fraction of the episodes reached at first that are reached then."""
    pairs = first.episodes.paired(then.episodes)
    crossed = [reached(after) for before, after in pairs if reached(before)]
    return sum(crossed) / len(crossed) if crossed else None


_COLUMNS = (
    Column("terrain", "scene", named=True),
    Column("policy", "policy", named=True),
    Column("step", "step", named=True),
    Column("success", "Δ success (p, Holm)"),
    Column("variation", "Δ pitch variation [rad]", sign="+"),
    Column("kept", "kept"),
    Column("causes", "failures by cause", named=True),
)


def tables(comparisons: Sequence[Mapping[str, Any]]) -> Iterator[Table]:
    """Yield the table of losses; a row for each step of each policy on each terrain."""
    rows = []
    for comparison in comparisons:
        causes = ", ".join(f"{cause} {count}" for cause, count in comparison["causes"].items())
        steps = {" → ".join(comparison["engines"]): comparison}
        if "sensed" in comparison:
            steps[comparison["sensed"]["sensor"]] = comparison["sensed"]
        for at, (step, lost) in enumerate(steps.items(), 1):
            fraction = lost["kept"]
            rows.append(
                {
                    "terrain": comparison["terrain"],
                    "policy": short(comparison["controller"]),
                    "step": step,
                    "causes": causes if at == len(steps) else "",
                    "success": gap_text(lost["gap"]["success"]),
                    "variation": lost["gap"]["pitch_variation_100hz"],
                    "kept": NONE if fraction is None else f"{100 * fraction:.3g} %",
                }
            )
    if rows:
        yield Table(_COLUMNS, rows, "From engine to engine, same episodes")


def failure_lines(comparisons: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a line for each failure in the last step."""
    for row in comparisons:
        for f in row["failures"]:
            yield (
                f"{row['terrain']}, episode {f['episode']}: {f['cause']} ({f['outcome']} after "
                f"{f['time']:.1f} s at x {f['x']:.2f} m, pitch {f['pitch']:.2f}, roll "
                f"{f['roll']:.2f}, yaw {f['yaw']:.2f} rad, {f['side']:.2f} m aside; "
                f"{f['default_outcome']} in {row['engines'][0]})"
            )
