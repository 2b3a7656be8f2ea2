"""The axes of a map: which settings vary, and their values.

In: a text such as ``terrain.height=0.1:0.6,sim.friction=0.4:1.0`` and the configuration of a scene.
Out: both axes, and the configuration of each point of their grid.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flipperctl.config import EvalConfig, with_overrides
from flipperctl.config.defaults import refuse_ineffective
from flipperctl.config.describe import Setting, settings
from flipperctl.errors import ConfigError, RequestError
from flipperctl.messages import close_match

Index = tuple[int, int]
"""Indices of a grid point: along the horizontal and along the vertical axis."""
EXAMPLE = "terrain.height=0.1:0.6,sim.friction=0.4:1.0"
_VALUES, _MOST = 20, 100
"""Number of values of an axis without a number of its own, and the largest number [-]."""
DIGITS = 6  # digits that the values of an axis are rounded to [-], so that a point can be typed
_SECTIONS = ("terrain", "robot", "sim", "perception", "episode")
_ENDS = ("_low", "_high")  # endings of two settings that are the range of a drawn number
_BOUND = re.compile(r"([≥>≤<]) ([-+.\de]+)")


@dataclass(frozen=True)
class Axis:
    """Settings with one common value, and the values along the axis."""

    name: str
    """The settings as the user named them."""
    keys: tuple[str, ...]
    """Paths of the settings in the configuration."""
    unit: str
    values: tuple[float, ...]
    """At least two values in increasing order, in the unit of the settings."""

    @property
    def label(self) -> str:
        """Name and unit, for figures."""
        return self.name if self.unit in ("", "-") else f"{self.name} [{self.unit}]"


def parse_axes(text: str, config: EvalConfig) -> tuple[Axis, Axis]:
    """Return the horizontal and the vertical axis that ``text``, given with ``--over``, names.

    Each is a setting of the terrain, robot, engine, sensor or episode with a range ``LOW:HIGH`` or
    ``LOW:HIGH:VALUES``, both ends included. Settings joined by ``+`` have one common value;
    ``terrain.height`` stands for ``terrain.height_low+terrain.height_high`` where these exist.
    Without a range, an axis leads from half to one and a half times the present value, within the
    bounds of the setting, or over the bounds if the value is 0 or null.
    """
    parts = text.split(",")
    if len(parts) != 2:
        raise RequestError(
            f"--over: two settings are allowed, as in --over {EXAMPLE}; got {text!r}"
        )
    known = {
        s.path: s
        for s in settings(config)
        if s.path.partition(".")[0] in _SECTIONS and "[" not in s.path and _is_number(s)
    }
    first, second = (_axis(part.strip(), config, known) for part in parts)
    if both := set(first.keys) & set(second.keys):
        raise ConfigError(f"--over: {min(both)} stands in both axes; two settings are needed")
    return first, second


def _is_number(setting: Setting) -> bool:
    """Return whether a setting is a number, or null in place of one."""
    value, kind = setting.value, setting.field.type
    if value is None:
        return "float" in kind or "int" in kind
    return isinstance(value, int | float) and not isinstance(value, bool)


def _axis(text: str, config: EvalConfig, known: Mapping[str, Setting]) -> Axis:
    name, _, ends = text.partition("=")
    keys = tuple(key for one in name.split("+") for key in _keys(one, config, known))
    refuse_ineffective(config, {key: f"--over {key}" for key in keys})
    found = [known[key] for key in keys]
    whole = all("float" not in s.field.type for s in found)
    low, high, count = _typed_range(ends, text) if ends else (*_default_range(found), _VALUES)
    values = [float(v) for v in np.linspace(low, high, count)]
    rounded = [round(v) if whole else float(f"{v:.{DIGITS}g}") for v in values]
    if len(different := tuple(dict.fromkeys(rounded))) < 2:
        raise RequestError(
            f"--over {text}: two different values are needed, "
            f"{'in whole numbers' if whole else 'in six digits'}; got {different[0]:g} alone"
        )
    return Axis(name, keys, found[0].field.unit, different)


def _keys(name: str, config: EvalConfig, known: Mapping[str, Setting]) -> tuple[str, ...]:
    """Return the paths that a name stands for."""
    ends = tuple(f"{name}{end}" for end in _ENDS)
    if name in known or all(end in known for end in ends):
        return (name,) if name in known else ends
    if any(s.path == name for s in settings(config)):
        raise ConfigError(f"--over {name}: it is no number of ground, robot, engine or sensor")
    there = sorted(path for path in known if path.startswith(f"{name.partition('.')[0]}."))
    allowed = ", ".join(there) or f"settings of {', '.join(_SECTIONS)}"
    raise ConfigError(
        f"--over {name}: there is no such setting{close_match(name, known)}; known: {allowed} "
        "(+ joins settings with one common value, as in terrain.low+terrain.high)"
    )


def _typed_range(ends: str, text: str) -> tuple[float, float, int]:
    """Return both ends of a typed range, and the number of its values."""
    try:
        low, high, *rest = (float(end) for end in ends.split(":"))
        (count,) = rest or [float(_VALUES)]
    except ValueError as error:
        raise RequestError(f"--over {text}: LOW:HIGH or LOW:HIGH:VALUES is allowed") from error
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise RequestError(f"--over {text}: a range from a lower to a higher number is allowed")
    if not (count.is_integer() and 2 <= count <= _MOST):
        raise RequestError(f"--over {text}: 2 to {_MOST} values are allowed")
    return low, high, int(count)


def _default_range(found: Sequence[Setting]) -> tuple[float, float]:
    """Return both ends of an axis without a typed range; ``found`` are its settings.

    A bound that is itself not allowed is replaced by a value a twentieth of the range inside it.
    """
    lows, highs = [], []
    for setting in found:
        ends = {sign: float(number) for sign, number in _BOUND.findall(setting.field.bounds)}
        low = ends.get("≥", ends.get(">", -math.inf))
        high = ends.get("≤", ends.get("<", math.inf))
        inside = (high - low) / 20
        lows.append(low + (inside if ">" in ends else 0.0))
        highs.append(high - (inside if "<" in ends else 0.0))
    low, high = max(lows), min(highs)
    if middle := sum(float(s.value or 0) for s in found) / len(found):
        near, far = sorted((0.5 * middle, 1.5 * middle))
        low, high = max(low, near), min(high, far)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise RequestError(
            f"--over {found[0].path}: give a range, as in --over {EXAMPLE}; its bounds and "
            "its present value give none"
        )
    return low, high


def grid_config(config: EvalConfig, axes: tuple[Axis, Axis], at: Index) -> EvalConfig:
    """Return the configuration of the grid point at two indices, one for each axis."""
    pairs = zip(axes, at, strict=True)
    return with_overrides(config, {k: a.values[index] for a, index in pairs for k in a.keys})
