"""The axes of a map: settings that vary together, and the values that they take.

In: text such as ``terrain.height=0.1:0.6,sim.friction=0.4:1.0`` and a configuration. Out: two axes,
each of which changes the configuration.
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

VALUES = 20
"""Number of values of an axis without a number of its own [-]."""
_MOST = 100
"""Largest number of values of an axis [-]."""
_SECTIONS = ("terrain", "robot", "sim", "perception", "episode")
_ENDS = ("_low", "_high")
"""Endings of two settings that are the range of a drawn number."""
_BOUND = re.compile(r"([≥>≤<]) ([-+.\de]+)")
EXAMPLE = "terrain.height=0.1:0.6,sim.friction=0.4:1.0"


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

    def at(self, index: int) -> dict[str, float]:
        """Return the overrides of the value at an index."""
        return dict.fromkeys(self.keys, self.values[index])


def parse_axes(text: str, config: EvalConfig, option: str = "--over") -> tuple[Axis, Axis]:
    """Return the horizontal and the vertical axis that ``text``, given with ``option``, names.

    Each is a setting of the terrain, robot, engine, sensor or episode with a range ``LOW:HIGH`` or
    ``LOW:HIGH:VALUES``, both ends included. Settings joined by ``+`` have one common value;
    ``terrain.height`` stands for ``terrain.height_low+terrain.height_high`` where these exist.
    Without a range, an axis leads from half to one and a half times the present value, within the
    bounds of the setting, or over the bounds if the value is 0 or null.

    Raises:
        RequestError: there are not two axes, or a range cannot be read.
        ConfigError: a setting does not exist, is no number, has no effect, or stands in both axes.
    """
    parts = text.split(",")
    if len(parts) != 2:
        raise RequestError(
            f"{option}: two settings are allowed, as in {option} {EXAMPLE}; got {text!r}"
        )
    known = {
        s.path: s
        for s in settings(config)
        if s.path.partition(".")[0] in _SECTIONS and "[" not in s.path and _is_number(s)
    }
    first, second = (_axis(part.strip(), config, known, option) for part in parts)
    if both := set(first.keys) & set(second.keys):
        raise ConfigError(f"{option}: {min(both)} stands in both axes; two settings are needed")
    return first, second


def grid_config(config: EvalConfig, axes: tuple[Axis, Axis], at: tuple[int, int]) -> EvalConfig:
    """Return the configuration of the grid point at two indices, one for each axis."""
    overrides: dict[str, float] = {}
    for axis, index in zip(axes, at, strict=True):
        overrides |= axis.at(index)
    return with_overrides(config, overrides)


def _axis(text: str, config: EvalConfig, known: Mapping[str, Setting], option: str) -> Axis:
    name, _, ends = text.partition("=")
    keys = tuple(key for one in name.split("+") for key in _keys(one, config, known, option))
    refuse_ineffective(config, {key: f"{option} {key}" for key in keys})
    found = [known[key] for key in keys]
    whole = all("float" not in s.field.type for s in found)
    values = _typed_values(ends, text, option) if ends else _default_values(found, option)
    # Six digits, so that a cell can be typed as an override.
    rounded = [round(v) if whole else float(f"{v:.6g}") for v in values]
    if len(different := tuple(dict.fromkeys(rounded))) < 2:
        raise RequestError(
            f"{option} {text}: two different values are needed, "
            f"{'in whole numbers' if whole else 'in six digits'}; got {different[0]:g} alone"
        )
    return Axis(name, keys, found[0].field.unit, different)


def _keys(
    name: str, config: EvalConfig, known: Mapping[str, Setting], option: str
) -> tuple[str, ...]:
    """Return the paths that a name stands for."""
    if name in known:
        return (name,)
    if all(f"{name}{end}" in known for end in _ENDS):
        return tuple(f"{name}{end}" for end in _ENDS)
    if any(s.path == name for s in settings(config)):
        raise ConfigError(f"{option} {name}: it is no number of ground, robot, engine or sensor")
    section = name.partition(".")[0]
    there = sorted(path for path in known if path.startswith(f"{section}."))
    allowed = ", ".join(there) or f"settings of {', '.join(_SECTIONS)}"
    raise ConfigError(
        f"{option} {name}: there is no such setting{close_match(name, known)}; known: {allowed} "
        "(+ joins settings with one common value, as in terrain.low+terrain.high)"
    )


def _is_number(setting: Setting) -> bool:
    """Return whether a setting is a number, or null in place of one."""
    value, kind = setting.value, setting.field.type
    if value is None:
        return "float" in kind or "int" in kind
    return isinstance(value, int | float) and not isinstance(value, bool)


def _typed_values(ends: str, text: str, option: str) -> list[float]:
    """Return the values of a typed range."""
    try:
        low, high, *rest = (float(end) for end in ends.split(":"))
        (cells,) = rest or [float(VALUES)]
    except ValueError as error:
        raise RequestError(f"{option} {text}: LOW:HIGH or LOW:HIGH:VALUES is allowed") from error
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise RequestError(f"{option} {text}: a range from a lower to a higher number is allowed")
    if not (cells.is_integer() and 2 <= cells <= _MOST):
        raise RequestError(f"{option} {text}: 2 to {_MOST} values are allowed")
    return [float(v) for v in np.linspace(low, high, int(cells))]


def _default_values(found: Sequence[Setting], option: str) -> list[float]:
    """Return the values of an axis without a range; ``found`` are its settings."""
    limits = [_limits(setting) for setting in found]
    low, high = max(low for low, _ in limits), min(high for _, high in limits)
    middle = sum(float(s.value or 0) for s in found) / len(found)
    if middle:
        near, far = sorted((0.5 * middle, 1.5 * middle))
        low, high = max(low, near), min(high, far)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise RequestError(
            f"{option} {found[0].path}: give a range, as in {option} {EXAMPLE}; its bounds and "
            "its present value give none"
        )
    return [float(v) for v in np.linspace(low, high, VALUES)]


def _limits(setting: Setting) -> tuple[float, float]:
    """Return the lowest and the highest value within the bounds; infinite without a bound.

    A bound that is itself not allowed is replaced by a value a twentieth of the range inside it.
    """
    ends = {sign: float(number) for sign, number in _BOUND.findall(setting.field.bounds)}
    low = ends.get("≥", ends.get(">", -math.inf))
    high = ends.get("≤", ends.get("<", math.inf))
    inside = (high - low) / 20
    return low + (inside if ">" in ends else 0.0), high - (inside if "<" in ends else 0.0)
