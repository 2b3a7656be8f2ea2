"""The settings that random configurations draw, and strategies for their values."""

import math
import types
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from hypothesis import strategies as st
from pydantic.fields import FieldInfo

from flipperctl.api import Settings, Terrain, registry
from flipperctl.api.plugin import Plugin, registered_names
from flipperctl.config import Randomise, TrainConfig

NOT_DRAWN = {
    "train.mode": "the other mode plays in worker processes",
    "train.workers": "mode exact has none",
    "train.decisions": "60",
    "device": "what this machine has",
    "collector": "mode exact plays episodes in the learner's process",
    "agent.start_from": "a file",
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
    "terrain.fewest": 8,
    "terrain.most": 8,
    "teacher.final_updates": 8,
    "agent.policy_gradient.decisions": 40,
    "agent.policy_gradient.passes": 3,
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
SECTIONS = ("robot", "episode", "agent", "train", "eval", "teacher")
GROUPS = {"terrain": "terrain", "network": "network", "sim": "sim", "perception": "perception"}
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
    default = {"terrain": "flat", "network": "at_d3qn"}.get(section, "planar")
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
    yield Setting("randomise.occlusion", Randomise.model_fields["occlusion"])


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
    """Return numbers at, next to and between the bounds, of every order of magnitude."""
    low, high, (above, below) = _bounds(metadata)
    if not math.isfinite(high):
        high = DEAREST
    if not math.isfinite(low):
        low = -high
    high = min(high, most) if most is not None else high
    if kind is int:
        first, last = int(low) + above, int(high) - below
        near = [n for n in (first, first + 1, last - 1, last) if first <= n <= last]
        return st.one_of(st.sampled_from(near), st.integers(first, last))
    first = math.nextafter(low, math.inf) if above else float(low)
    last = math.nextafter(high, -math.inf) if below else float(high)
    near = [first, last, math.nextafter(first, math.inf), math.nextafter(last, -math.inf)]
    uniform = st.floats(first, last, allow_subnormal=False, width=64)
    if first >= 0:
        smallest = max(first, 1e-9 * last)
        logarithmic = st.floats(math.log(smallest), math.log(last)).map(
            lambda power: min(last, max(first, math.exp(power)))
        )
        return st.one_of(st.sampled_from(near), uniform, logarithmic)
    return st.one_of(st.sampled_from(near), uniform)
