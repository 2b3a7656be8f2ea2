"""What the methods of plugins return: a table for each kind, and the check of a value against it.

In: a plugin, a method and what it returned. Out: the value, or an error that names plugin, method,
file and line. The conformance suite and the first episode of each environment check every value;
later episodes check only that numbers are finite.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from flipperctl.api import (
    ACTIONS,
    SAMPLE_PERIOD,
    CameraImage,
    Command,
    Instrument,
    Outcome,
    Plugin,
    RobotState,
    SensedAngles,
    SensedGround,
    Sensor,
    StateGroups,
    Terrain,
)
from flipperctl.plugging.guard import naming, refusal, short_repr

LONGEST = 1000
"""Largest number of samples between two measurements of an instrument [-]."""
_ANY = -1
"""Any length of an axis."""
_REAL = "fiu"
"""Kinds of numpy's types that are real numbers."""
Length = int | Callable[..., int]
"""Length of an axis: a number, or a function of the plugin and the arguments of the call."""


@dataclass(frozen=True)
class Rule:
    """What a method may return."""

    allowed: str
    fault: Callable[..., str]
    """Describes a value that is not allowed, by the plugin and the arguments; else empty."""


def _where(allowed: str, holds: Callable[..., bool]) -> Rule:
    return Rule(
        allowed, lambda value, *arguments: "" if holds(value, *arguments) else short_repr(value)
    )


def _instance(cls: type, article: str = "a") -> Rule:
    return _where(f"{article} {cls.__name__}", lambda value, *_: isinstance(value, cls))


def _methods(what: str, *names: str) -> Rule:
    def fault(value: object, *_: object) -> str:
        missing = [name for name in names if not hasattr(value, name)]
        if isinstance(value, type) or missing:
            return f"{short_repr(value)}, which has no {', '.join(missing or names)}"
        return ""

    return Rule(what, fault)


def _array(*shape: Length, kinds: str = _REAL, low: float | None = None) -> Rule:
    """Return the rule of an array; ``low``: its least element."""

    def fault(value: Any, *arguments: object) -> str:
        if not isinstance(value, np.ndarray):
            return short_repr(value)
        # Shape and type first; a value out of bounds is told by its number.
        lengths = [n(*arguments) if callable(n) else n for n in shape]
        fits = value.ndim == len(lengths) and all(
            n in (_ANY, length) for n, length in zip(lengths, value.shape, strict=True)
        )
        if not (fits and value.dtype.kind in kinds):
            expected = tuple("any" if n == _ANY else n for n in lengths)
            return f"an array of {value.dtype} and the shape {value.shape} for {expected}"
        least = "" if low is None or (value >= low).all() else f"{value.min()}, below {low:g}"
        return f"an array with {least}" if least else ""

    return Rule(f"an array of {'booleans' if kinds == 'b' else 'numbers'}", fault)


def _optional(rule: Rule) -> Rule:
    return Rule(
        f"{rule.allowed}, or None",
        lambda value, *arguments: "" if value is None else rule.fault(value, *arguments),
    )


def _record(cls: type, **parts: Rule) -> Rule:
    """Return the rule of an object whose attributes have rules, which are given it last."""

    def fault(value: object, *arguments: object) -> str:
        if not isinstance(value, cls):
            return short_repr(value)
        arguments = (*arguments, value)
        faults = (
            (name, rule.fault(getattr(value, name), *arguments)) for name, rule in parts.items()
        )
        text = next((f"whose {name} is {text}" for name, text in faults if text), "")
        return text and f"a {cls.__name__} {text}"

    return Rule(f"a {cls.__name__} of such values as flipperctl.api states", fault)


def _as_float(value: object) -> float | None:
    """Return a real number as a float, NaN and infinity included; None for anything else."""
    try:
        return float(value) if isinstance(value, Real) else None
    except OverflowError:
        return None


def _is_finite(value: object) -> bool:
    """Return whether a value is a finite real number."""
    number = _as_float(value)
    return number is not None and math.isfinite(number)


def _is_pair(value: object, *_: object) -> bool:
    return (
        isinstance(value, tuple | list | np.ndarray)
        and len(value) == 2
        and all(map(_is_finite, value))
    )


def _are_instruments(parts: object, *_: object) -> bool:
    return parts is None or (
        isinstance(parts, Mapping)
        and all(isinstance(name, str) for name in parts)
        and all(isinstance(part, Instrument) and _is_period(part.period) for part in parts.values())
    )


def _is_period(period: Any) -> bool:
    samples = period / SAMPLE_PERIOD if _is_finite(period) else 0.0
    whole = 0.5 < samples <= LONGEST + 1e-6 and abs(samples - round(samples)) < 1e-6
    return period is None or whole


def _are_finite_groups(groups: Any, *_: object) -> bool:
    return (
        isinstance(groups, StateGroups)
        and groups.observations.ndim == 3
        and groups.values.shape == (*groups.observations.shape[:2], len(ACTIONS))
        and groups.values.size > 0
        and bool(np.isfinite(groups.values).all() and np.isfinite(groups.observations).all())
    )


def _pair_of(first: Rule, second: Rule) -> Rule:
    def fault(value: object, *arguments: object) -> str:
        if not (isinstance(value, tuple) and len(value) == 2):
            return short_repr(value)
        return first.fault(value[0], *arguments) or second.fault(value[1], *arguments)

    return Rule(f"{first.allowed}, and {second.allowed}", fault)


_NUMBER = _where("a finite number", lambda value, *_: _is_finite(value))
_REAL_NUMBER = _where("a number", lambda value, *_: _as_float(value) is not None)
_SHARE = _where("a number from 0 to 1", lambda value, *_: _is_finite(value) and 0 <= value <= 1)
_STATE = _record(
    RobotState,
    position=_array(2),
    velocity=_array(2),
    orientation=_optional(_array(3, 3)),
    belts=_optional(_array(2)),
    **dict.fromkeys(
        ("pitch", "front", "rear", "pitch_rate", "time", "roll", "yaw", "side", "side_velocity"),
        _REAL_NUMBER,
    ),
)
_SENSED = _pair_of(
    _record(
        SensedGround,
        points=_array(_ANY, 2),
        heights=_optional(_array(lambda sensor, *_: sensor.layout.heights)),
        filled=_optional(_array(lambda *arguments: len(arguments[-1].points), kinds="b")),
        seen=_optional(_array(lambda sensor, *_: sensor.layout.bins, kinds="b")),
        position=_optional(_array(2)),
        deviation=_optional(_array(lambda sensor, *_: sensor.layout.bins, low=0.0)),
    ),
    _record(SensedAngles, **dict.fromkeys(("front", "rear", "pitch", "roll"), _REAL_NUMBER)),
)

RULES: Mapping[str, Mapping[str, Rule]] = {
    "terrain": {
        "at": _instance(Terrain),
        "first_difficulty": _SHARE,
        "next_difficulty": _SHARE,
    },
    "sim": {
        "place": _methods(
            "a flipperctl.api.World",
            "command",
            "advance",
            "state",
            "penetration",
            "save",
            "load",
        ),
        "position": _where("two finite numbers", _is_pair),
        "pitch": _NUMBER,
        "advance": _array(_ANY, lambda engine, *_: 5 if engine.flippers == ("pairs",) else _ANY),
        "state": _STATE,
        "penetration": _NUMBER,
        "ended": _optional(_instance(Outcome, "an")),
        "flipper_work": _NUMBER,
        "roll_variation": _NUMBER,
        "cast_rays": _array(lambda _, origin, directions, *__: len(directions), low=0.0),
        "look": _record(
            CameraImage,
            pixels=_array(lambda _, view, w, h, *__: h, lambda _, view, w, h, *__: w, 3),
            depth=_array(lambda _, view, w, h, *__: h, lambda _, view, w, h, *__: w),
        ),
        "draw": _array(lambda _, w, h: h, lambda _, w, h: w, 3, kinds="u"),
        "versions": _where(
            "a mapping of names to texts",
            lambda versions, *_: (
                isinstance(versions, Mapping)
                and all(isinstance(text, str) for item in versions.items() for text in item)
            ),
        ),
    },
    "perception": {
        "exact": _where(
            "a Sensor of the same layout",
            lambda exact, sensor, *_: isinstance(exact, Sensor) and exact.layout == sensor.layout,
        ),
        "over": _methods("a flipperctl.api.GroundSensor", "sense"),
        "instruments": _where(
            "None, or a mapping of names to Instruments whose period is None or a whole multiple "
            f"of {SAMPLE_PERIOD:g} s up to {LONGEST * SAMPLE_PERIOD:g} s",
            _are_instruments,
        ),
        "estimator": _methods("a flipperctl.api.Estimator", "update", "estimate", "save", "load"),
        "sense": _SENSED,
        "estimate": _SENSED,
    },
    "controller": {
        "build": _methods("an object with reset and act", "reset", "act"),
        "command": _instance(Command),
        "groups": _where("StateGroups of finite numbers", _are_finite_groups),
    },
}
"""Kind of plugin → method of it, or of what it builds → what it may return."""


def require(plugin: Plugin, method: str, value: Any, *arguments: Any, owner: object = None) -> Any:
    """Return what a plugin's method returned for the ``arguments``, if that is allowed.

    ``owner``: the object of the method, if the plugin built it.

    Raises:
        PluginFailedError: it is not allowed.
    """
    # The method of the object is named, where the plugin built it.
    rule = RULES[plugin.kind][method]
    with naming(plugin, method):  # the value's own code may fail
        fault = rule.fault(value, plugin, *arguments)
    if fault:
        cls = None if owner is None else type(owner)
        text = f"returned {fault}; allowed: {rule.allowed}"
        raise refusal(plugin, method, text, owner=cls)
    return value


class Checked:
    """An object that a plugin built; what its methods return is checked.

    Attributes without a rule are the object's own.
    """

    def __init__(self, plugin: Plugin, built: Any) -> None:
        """Check ``built``."""
        self._plugin, self._built = plugin, built

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the object; a method is checked when it is called."""
        if name[0] == "_":  # of a copy that is not set up yet
            raise AttributeError(name)
        value = getattr(self._built, name)
        if name not in RULES[self._plugin.kind]:
            return value
        if not callable(value):
            return require(self._plugin, name, value, owner=self._built)

        def call(*arguments: Any) -> Any:
            return require(self._plugin, name, value(*arguments), *arguments, owner=self._built)

        return call
