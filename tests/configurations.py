"""Random training configurations, drawn with Hypothesis from the types and bounds of all settings.

``overrides()`` draws dotted overrides of a short training; ``attempt`` trains with them. A setting
of any type but those that ``_values`` knows keeps its default; ``left_out`` lists these.
"""

import math
import re
import types
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from hypothesis import strategies as st
from pydantic.fields import FieldInfo

from flipperctl.api import IntRange, Range, Settings, Terrain, registry
from flipperctl.api.plugin import Plugin, registered_names
from flipperctl.config import TrainConfig, with_overrides
from flipperctl.config.sampled import FIRST
from flipperctl.config.sampled import SECTIONS as SAMPLED
from flipperctl.errors import RequestError
from flipperctl.training.run import start

DECISIONS = 60
FIXED = {
    "train.mode": "exact",
    "train.decisions": DECISIONS,
    "train.validation_episodes": 1,
    "train.regret_episodes": 0,
    "agent.learning_starts": 16,
    "agent.batch_size": 8,
    "episode.run_out": 0.2,
    "episode.slack": 2.0,
    "terrain.length": 0.5,
}
"""What makes the base short, beside searches of little depth; all but the first two are drawn."""
Overrides = dict[str, Any]
PATHS = tuple(f"{section}." for section in SAMPLED)
"""Sections whose settings are sampled by path."""


NOT_DRAWN = {
    "train.mode": "the other mode plays in worker processes",
    "train.workers": "mode exact has none",
    "train.decisions": "60",
    "device": "what this machine has",
    "collector": "mode exact plays episodes in the learner's process",
    "agent.start_from": "a file",
    "agent.settings": "arguments of an algorithm of Stable-Baselines3",
    "teacher.episodes": "a file",
    "terrain.path": "a file",
    "eval.ray": "the address of a cluster",
}
COSTLY = {
    "train.validation_episodes": 2,
    "train.regret_episodes": 2,
    "train.threads": 2,
    "agent.batch_size": 256,
    "perception.azimuths": 16,
    "episode.slack": 5,
    "episode.run_up": 4,
    "episode.run_out": 4,
    "perception.density": 200,
    "sim.variation": 1000,
    "network.fused": 256,
    "network.head": 256,
    "network.quantiles": 64,
    **dict.fromkeys(("terrain.steps", "terrain.blocks", "terrain.obstacles"), 8),
    "teacher.final_updates": 8,
    "teacher.controller.budget": 2000,
    "teacher.controller.width": 20,
    "teacher.controller.beam": 16,
    "teacher.controller.of_each": 16,
    "teacher.controller.horizon": 9,
    "teacher.controller.iterations": 12,
}
"""Settings drawn up to a smaller value than their own, since more would only take longer."""
DEAREST = 300
"""Largest number drawn for a setting without an upper bound."""
SECTIONS = ("robot", "episode", "train", "eval", "teacher")
GROUPS = {
    "terrain": "terrain",
    "network": "network",
    "agent": "agent",
    "sim": "sim",
    "perception": "perception",
}
"""Section with one plugin → the plugin's kind."""


@dataclass(frozen=True)
class Setting:
    """A setting that can be drawn."""

    path: str
    info: FieldInfo

    def values(self) -> st.SearchStrategy | None:
        """Return a strategy for allowed values, or None for a type that is not drawn."""
        if self.path in NOT_DRAWN:
            return None
        return _values(self.info.annotation, tuple(self.info.metadata), COSTLY.get(self.path))

    def wrong(self) -> list[Any]:
        """Return values just outside of the bounds, and no numbers."""
        low, high, _ = _bounds(tuple(self.info.metadata))
        beyond = [math.nextafter(low, -math.inf)] if math.isfinite(low) else []
        beyond += [math.nextafter(high, math.inf)] if math.isfinite(high) else []
        return [*beyond, math.nan, "word"] if self.info.annotation in (int, float) else ["word"]


def plugin_names(section: str) -> st.SearchStrategy[str]:
    default = {"terrain": "flat", "network": "at_d3qn", "agent": "d3qn"}.get(section, "planar")
    others = [name for name in registered_names(GROUPS[section]) if name != "mujoco"]
    names = [default] * len(others) + others
    if section == "sim":
        names += ["mujoco"] if "mujoco" in registered_names("sim") else []
    return st.sampled_from(names)


def section_settings() -> Iterator[Setting]:
    for section in SECTIONS:
        model = TrainConfig.model_fields[section].annotation
        for name, info in model.model_fields.items():
            if (section, name) != ("teacher", "controller"):
                yield from _of_field(f"{section}.{name}", info)
    yield Setting("seed", TrainConfig.model_fields["seed"])


def _of_field(path: str, info: FieldInfo) -> Iterator[Setting]:
    """Yield a setting, or those of a section within its section."""
    kind = info.annotation
    if isinstance(kind, type) and issubclass(kind, Settings) and not issubclass(kind, Plugin):
        for name, inner in kind.model_fields.items():
            yield from _of_field(f"{path}.{name}", inner)
    else:
        yield Setting(path, info)


def plugin_settings(section: str, kind: str, name: str) -> list[Setting]:
    fields = registry[kind, name].model_fields.items()
    return [Setting(f"{section}.{field}", info) for field, info in fields]


def _values(annotation: Any, metadata: tuple, most: float | None) -> st.SearchStrategy | None:
    """Return a strategy for the values of a type with its bounds, or None for other types."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        inner = [i.metadata if isinstance(i, FieldInfo) else [i] for i in parts[1:]]
        return _values(parts[0], tuple(item for items in inner for item in items), most)
    if origin in (Union, types.UnionType):
        found = [_values(part, metadata, most) for part in parts if part is not type(None)]
        return None if None in found else st.one_of(st.none(), *found)
    if origin is Literal:
        return st.sampled_from(parts)
    if origin is tuple:
        return _tuples(parts, metadata, most)
    if annotation is bool:
        return st.booleans()
    if annotation in (int, float):
        return _numbers(annotation, metadata, most)
    if annotation in (Range, IntRange):
        ends = _numbers(int if annotation is IntRange else float, metadata, most)
        return st.one_of(ends, st.lists(ends, min_size=2, max_size=2).map(sorted))
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return st.sampled_from([item.value for item in annotation])
    if isinstance(annotation, type) and issubclass(annotation, Terrain):
        return st.sampled_from(registered_names("terrain")).map(lambda name: {"name": name})
    return None


def _tuples(parts: tuple, metadata: tuple, most: float | None) -> st.SearchStrategy | None:
    items = [_values(part, (), most) for part in parts if part is not Ellipsis]
    if None in items:
        return None
    if Ellipsis not in parts:
        return st.tuples(*items).map(list)
    fewest = max([0, *(getattr(item, "min_length", 0) for item in metadata)])
    return st.lists(items[0], min_size=fewest, max_size=3)


def _bounds(metadata: tuple) -> tuple[float, float, tuple[bool, bool]]:
    """Return the lower and upper bound, infinite without one, and whether each is left out."""
    low, high, opened = -math.inf, math.inf, [False, False]
    for item in metadata:
        for name, sign in (("ge", 1), ("gt", 1), ("le", -1), ("lt", -1)):
            if (bound := getattr(item, name, None)) is not None:
                low, high = (bound, high) if sign > 0 else (low, bound)
                opened[0 if sign > 0 else 1] = name in ("gt", "lt")
    return low, high, (opened[0], opened[1])


def _numbers(kind: type, metadata: tuple, most: float | None) -> st.SearchStrategy:
    """Return numbers between the bounds, as Hypothesis draws them: often the simplest."""
    low, high, (above, below) = _bounds(metadata)
    if not math.isfinite(high):
        high = DEAREST
    if not math.isfinite(low):
        low = -high
    high = min(high, most) if most is not None else high
    if kind is int:
        return st.integers(int(low) + above, int(high) - below)
    bounds = {"min_value": float(low), "max_value": float(high)}
    return st.floats(**bounds, exclude_min=above, exclude_max=below, allow_subnormal=False)


@st.composite
def overrides(draw: st.DrawFn) -> Overrides:
    """Draw up to 14 settings over all sections, with the plugins of each group."""
    found: Overrides = {}
    plugins = {name: draw(plugin_names(name)) for name in GROUPS}
    pool = [*section_settings()]
    for section, name in plugins.items():
        pool += plugin_settings(section, GROUPS[section], name)
    terms = draw(st.lists(st.sampled_from(registered_names("reward")), unique=True, max_size=4))
    for term in terms:
        pool += plugin_settings(f"rewards.{term}", "reward", term)
    teacher = draw(st.sampled_from([None] * 12 + registered_names("controller")))
    if teacher is not None:
        pool += plugin_settings("teacher.controller", "controller", teacher)
    known = {setting.path: values for setting in pool if (values := setting.values()) is not None}
    names = draw(st.lists(st.sampled_from(sorted(known)), unique=True, max_size=14))
    for section, name in plugins.items():
        found[section] = {"name": name}
        if name == "flat" and "terrain.length" not in names:
            found["terrain"]["length"] = FIXED["terrain.length"]
        if name == "lidar" and "perception.azimuths" not in names:
            found["perception"]["azimuths"] = 8  # of a slow robot's decision, hundreds of scans
    for term in terms:
        found[f"rewards.{term}"] = {"name": term}
    for term in draw(st.sets(st.sampled_from(["flipper", "pitch", "end"]), max_size=3)):
        found.setdefault(f"rewards.{term}", None)
    if teacher is not None:
        found["teacher.controller"] = {"name": teacher}
        for name in ("horizon", "beam"):  # a search predicts each decision, however long it is
            path = f"teacher.controller.{name}"
            if path in known and path not in names:
                found["teacher.controller"][name] = 2
    for name in names:
        found[name] = draw(known[name])
    for path in FIRST:
        section, _, name = path.partition(".")
        if name != "occlusion" and draw(st.integers(0, 40)) == 40:
            cls = registry.get((section, plugins.get(section, "")))
            model = cls or TrainConfig.model_fields[section].annotation
            if (info := model.model_fields.get(name)) is not None:
                values = Setting(f"{section}.{name}", info).values()
                found[f"randomise.{path}"] = sorted(draw(st.tuples(values, values)))
    paths = [s for s in pool if s.path.startswith(PATHS) and s.info.annotation in (int, float)]
    for setting in draw(st.lists(st.sampled_from(paths), max_size=1)):
        values = setting.values()
        found[f"randomise.{setting.path}"] = sorted(draw(st.tuples(values, values)))
    if draw(st.integers(0, 9)) == 9:
        wrong = draw(st.sampled_from([s for s in pool if s.path not in NOT_DRAWN]))
        found[wrong.path] = draw(st.sampled_from(wrong.wrong()))
    return found


def left_out() -> list[str]:
    """Return the settings whose type is not drawn."""
    named = ((section, kind, n) for section, kind in GROUPS.items() for n in registered_names(kind))
    settings = [*section_settings(), *(s for group in named for s in plugin_settings(*group))]
    return sorted({s.path for s in settings if s.values() is None} - set(NOT_DRAWN))


def attempt(drawn: Overrides, folder: Path) -> None:
    """Train 60 decisions with the drawn overrides in an empty folder.

    A refusal is right where it names a section; any other error is a fault.
    """
    try:
        base = TrainConfig(terrain="flat", network="at_d3qn")
        start(with_overrides(base, {**FIXED, "terrain": {"name": "flat"}, **drawn}), folder)
    except RequestError as error:
        names = "|".join((*SECTIONS, *GROUPS, "rewards", "randomise"))
        text = str(error).replace("flipperctl train", "")
        if not re.search(rf"\b({names})\b|\breward '", text):
            raise  # it names no section
