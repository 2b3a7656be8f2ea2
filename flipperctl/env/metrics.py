"""The metrics of one episode: its measures, its return and the parts of each reward term.

In: the transitions of an episode with their rewards. Out: numbers by name, for rows and files.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Measure, Plugin, Transition, registry
from flipperctl.config import resolver
from flipperctl.errors import NonFiniteError, PluginError, PluginFailedError
from flipperctl.plugging.guard import as_real, definition, plugin_label, refusal, short_repr

CORE = (
    "decisions",
    "t_cost",
    "pitch_variation_decisions",
    "pitch_variation_100hz",
    "max_pitch",
    "flipper_travel",
)
"""Measures for which results have fields of their own, in the order of their columns."""
RENAMED: Mapping[str, str] = {
    f"{angle}_variation": f"{angle}_variation_decisions" for angle in ("pitch", "roll")
}
"""New names of measures by those that they had until version 0.3."""


def with_both_names(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Return a JSON document's numbers by former and present names, whichever it has."""
    names = [pair for old, new in RENAMED.items() for pair in ((old, new), (new, old))]
    more = {name: numbers[known] for name, known in names if known in numbers}
    return {**numbers, **{name: value for name, value in more.items() if name not in numbers}}


DRAWN = "drawn_"
"""Prefix of the columns of numbers that the terrain drew."""

RESERVED = frozenset(
    {
        "baseline",
        "baselines",
        "by",
        "cause",
        "conditions",
        "conditions_hash",
        "controller",
        "crossed_by",
        "decision",
        "difference",
        "difficulty",
        "duration",
        "end_pitch",
        "end_roll",
        "end_side",
        "end_x",
        "end_yaw",
        "episode",
        "episodes",
        "epsilon",
        "failed_by",
        "kind",
        "lag",
        "loss",
        "mean_return",
        "method",
        "n",
        "not_reached",
        "outcome",
        "outcomes",
        "parts",
        "passable",
        "policy",
        "reached",
        "return",
        "risk",
        "risk_announced",
        "risk_brier",
        "risk_failures",
        "risk_false_alarms",
        "risk_false_warnings",
        "risk_horizon",
        "risk_reached",
        "risk_shift",
        "risk_slope",
        "risk_threshold",
        "risks",
        "scene",
        "search",
        "seconds",
        "seed",
        "start_front",
        "start_rear",
        "start_shift",
        "success",
        "success_rate",
        "terrain",
        "training",
        "training_seed",
        *RENAMED,
    }
)
"""Columns and keys of files besides the measures."""
_PREFIXES = ("reward_", "search_", "not_reached_", DRAWN)


def measures() -> dict[str, Measure]:
    """Return every registered measure by name: ``CORE``, then the further ones by name."""
    core = (resolver.get(Measure.kind, name, name) for name in CORE)
    return {cls.plugin_name: _make(cls) for cls in (*core, *other_measures())}


def other_measures() -> list[type[Measure]]:
    """Return the measures beyond ``CORE``, sorted by name."""
    return [
        cls
        for (kind, name), cls in sorted(registry.items(), key=lambda entry: entry[0])
        if kind == Measure.kind and name not in CORE and issubclass(cls, Measure)
    ]


def logged() -> list[str]:
    """Return the names of the measures that trainings log, in the order of ``measures``."""
    return [
        name
        for name, measure in measures().items()
        if not (measure.mapped_only or measure.operated_only)
    ]


def occurring(further: Iterable[Mapping[str, object]]) -> list[type[Measure]]:
    """Return the measures beyond ``CORE`` that occur as a key, sorted by name."""
    names = {name for values in further for name in values}
    return [cls for cls in other_measures() if cls.plugin_name in names]


def shown(further: Iterable[Mapping[str, object]]) -> list[type[Measure]]:
    """Return the ``occurring`` measures that printed tables have."""
    return [measure for measure in occurring(further) if measure.in_tables]


def heading(measure: type[Measure]) -> str:
    """Return the heading of a measure in tables and figures: its name in words and its unit."""
    words = {"t_cost": "time"}.get(measure.plugin_name, measure.plugin_name)
    words = re.sub("^max_", "largest_", words.removesuffix("_100hz"))
    words = words.replace("_decisions", "_at_decisions").replace("_", " ")
    return f"{words} [{measure.unit}]"


class EpisodeMetrics:
    """Collects the transitions and the weighted reward terms of one episode."""

    def __init__(self, measures: Mapping[str, Measure]) -> None:
        self._measures = measures
        self._episode: list[Transition] = []
        self._rewards: list[Mapping[str, float]] = []

    def add(self, t: Transition, parts: Mapping[str, float]) -> None:
        """Add one decision with the weighted values of its reward terms."""
        self._episode.append(t)
        self._rewards.append(parts)

    def summary(self) -> dict[str, float]:
        """Return numbers by name: each measure, the return, and each reward term's part of it."""
        parts = dict.fromkeys(self._rewards[0], 0.0)
        for rewards in self._rewards:
            for name, value in rewards.items():
                parts[name] += value
        return {
            **{
                name: _value(measure, self._episode)
                for name, measure in self._measures.items()
                if applies(measure, self._episode)
            },
            "return": sum(parts.values()),
            **{f"reward_{name}": value for name, value in parts.items()},
        }


def applies(measure: Measure, episode: Sequence[Transition]) -> bool:
    """Return whether the episode has the measure."""
    perceived = episode[0].perception
    if measure.operated_only and episode[0].commands is None:
        return False
    if measure.rolled_only and episode[0].roll_variation is None:
        return False
    return not measure.mapped_only or (perceived is not None and perceived.seen is not None)


class Pitches:
    """The pitches of an episode so far, which its transitions share.

    With a copy in each, memory would grow with the square of the episode's length: 2 GB on 1 km.
    """

    def __init__(self) -> None:
        self._count = 0
        self._reserve(np.empty(128))

    def _reserve(self, values: FloatArray) -> None:
        self._values, self._readable = values, values.view()
        self._readable.flags.writeable = False

    def append(self, pitch: float) -> FloatArray:
        """Add a pitch; return all so far, read-only, (T,) [rad]."""
        # Doubling keeps appending cheap; earlier views keep the old array.
        if self._count == len(self._values):
            self._reserve(np.concatenate([self._values, np.empty(self._count)]))
        self._values[self._count] = pitch
        self._count += 1
        return self._readable[: self._count]


def _make(cls: type[Plugin]) -> Measure:
    name = cls.plugin_name
    # A measure's name is a column of files, and must be free there.
    if name in RESERVED or name.startswith(_PREFIXES):
        raise PluginError(
            f"{plugin_label(cls)}: files have another column or key {name!r}; choose another name "
            f"({definition(cls)})"
        )
    measure = resolver.construct(cls, {})
    assert isinstance(measure, Measure)
    return measure


def _value(measure: Measure, episode: Sequence[Transition]) -> float:
    returned: object = measure(episode)
    value = as_real(returned)
    if value is None or isinstance(value, bool) or not math.isfinite(value):
        text = f"returned {short_repr(returned)}; a finite number is allowed"
        kind = PluginFailedError if value is None else NonFiniteError
        raise refusal(measure, "__call__", text, kind)
    return value if isinstance(value, int) else float(value)
