"""Checks of a sensor: perceptions, sampling, randomness, snapshots and portability.

A robot's computer may lack what an estimator needs beyond Python, numpy and ``flipperctl.core``.
"""

from __future__ import annotations

import dis
import inspect
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from types import CodeType, FunctionType, ModuleType

import numpy as np

from flipperctl.api import (
    SAMPLE_PERIOD,
    Measured,
    Mounting,
    Perception,
    Profile,
    Robot,
    RobotState,
    Sensor,
    Start,
    action_index,
)
from flipperctl.config import EnvConfig
from flipperctl.env.drive import Drive
from flipperctl.env.perceiving import Perceiver
from flipperctl.plugging.guard import short_repr
from flipperctl.plugging.randomness import global_states, moved_since
from flipperctl.testing.check import of, require
from flipperctl.testing.conventions import probe_sensing, require_conventions

_PRESENT = (*sys.stdlib_module_names, "numpy", "flipperctl.core")


GROUND = Profile([(0.0, 0.0), (0.0, 0.2), (1.0, 0.2), (1.0, 0.0)])
START = Start(-0.8)
_MARGIN = 5.0
"""Length of the level ground before and past ``GROUND`` that may come into view [m]."""
_PERIOD = 0.6
"""Time of a decision [s]."""
_RAISE = action_index(1, 0)


_Taken = tuple[str, float, str | None]
"""A measurement's instrument and time [s], and what is wrong with its value, which may be a large
scan and is not kept; None: nothing."""


@of("perception", "episodes")
def episodes(sensor: Sensor) -> None:
    """Check that equal generators give equal perceptions, and instruments plain data in time.

    They measure at the start and at multiples of their period.
    """
    before = global_states()
    (first, taken), (other, _) = _episode(sensor), _episode(sensor)
    moved = moved_since(before)
    require(not moved, f"draws from {moved}; only rng is allowed")

    # Each instrument measures plain data, at the times of its period.
    for name, instrument in (sensor.instruments(_mounting(_drive(sensor))) or {}).items():
        for measured, _, fault in taken:
            if measured == name:
                require(fault is None, f"instrument {name!r} returned {fault}")
        times = [time for measured, time, _ in taken if measured == name]
        period = instrument.period or _PERIOD
        due = np.arange(round((2 * _PERIOD) / SAMPLE_PERIOD) + 1) * SAMPLE_PERIOD
        due = due[:: round(period / SAMPLE_PERIOD)]
        if 0 < len(times) < len(due):  # returns None in between, equally often each time
            due = due[:: math.ceil(len(due) / len(times))]
        require(
            len(times) == len(due) and bool(np.allclose(times, due)),
            f"instrument {name!r} measured {len(times)} times in {2 * _PERIOD:g} s; "
            f"{len(due)} are expected at a period of {period:g} s",
        )
    require(_equal(first, other), "equal generators give unequal perceptions")
    for p in first:
        require(bool((np.diff(p.points[:, 0]) >= 0).all()), "the points' x decreases")


@of("perception", "returns")
def returns(sensor: Sensor) -> None:
    """Check that a snapshot restores the sensor's measurements, estimates and random draws."""
    first, *rest = _states()
    perceiver = _perceiver(sensor, _drive(sensor))
    _perceived(perceiver, [first])
    saved = perceiver.save()
    before = _perceived(perceiver, rest)
    perceiver.load(saved)
    require(
        _equal(before, _perceived(perceiver, rest)),
        "its perceptions differ after its snapshot is loaded; each part with a memory needs save "
        "and load, and later calls must not change a saved snapshot",
    )


@of("perception", "portable", everywhere=False)
def portable(sensor: Sensor) -> None:
    """Check that the estimator needs only Python, numpy and ``flipperctl.core``."""
    if sensor.instruments(_mounting(_drive(sensor))) is None:
        return
    estimator = sensor.estimator(Robot())
    foreign = sorted(foreign_names(type(estimator)))
    require(
        not foreign,
        f"its estimator {type(estimator).__name__} uses {', '.join(foreign)}; it runs on a robot, "
        "where Python, numpy and flipperctl.core are allowed",
    )


@of("perception", "conventions", everywhere=False)
def conventions(sensor: Sensor) -> None:
    """Check signs, frames and units of a sensor that perceives one state without a motion."""
    if inspect.unwrap(type(sensor).over) is not inspect.unwrap(Sensor.over):
        require_conventions(list(probe_sensing(EnvConfig(terrain="flat", perception=sensor))))


def foreign_names(cls: type) -> set[str]:
    """Return the foreign names that the class's methods use, directly or via its module."""
    return set(_foreign(cls, cls.__module__, set()))


def _foreign(value: object, home: str, seen: set[int]) -> Iterator[str]:
    if id(value) in seen:
        return
    seen.add(id(value))
    # Code of the estimator's own module is followed; other modules are judged by their names.
    named = isinstance(value, type | FunctionType)
    module = str(getattr(value if named else type(value), "__module__", "builtins"))
    if isinstance(value, ModuleType):
        yield from _absent(value.__name__)
    elif module != home:
        name = getattr(value, "__qualname__", type(value).__qualname__)
        yield from (f"{absent}.{name}" for absent in _absent(module))
    elif isinstance(value, type):
        for part in (*value.__bases__, *vars(value).values()):
            yield from _foreign(_function(part), home, seen)
    elif isinstance(value, FunctionType):
        for instruction in _instructions(value.__code__):
            name = instruction.argval
            if instruction.opname == "IMPORT_NAME":
                yield from _absent(name)
            elif instruction.opname == "LOAD_GLOBAL" and name in value.__globals__:
                yield from _foreign(_function(value.__globals__[name]), home, seen)


def _absent(module: str) -> Iterator[str]:
    """Yield the name of a module unless every robot has it."""
    if not any(module == name or module.startswith(f"{name}.") for name in _PRESENT):
        yield module


def _instructions(code: CodeType) -> Iterator[dis.Instruction]:
    """Yield the instructions of a function and of the functions inside it."""
    yield from dis.get_instructions(code)
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _instructions(inner)


def _function(part: object) -> object:
    """Return the function that a property, method, cache or partial wraps; others unchanged."""
    if isinstance(part, FunctionType | ModuleType | type):
        return part
    inner = (getattr(part, name, None) for name in ("fget", "__func__", "__wrapped__", "func"))
    return next((_function(function) for function in inner if callable(function)), part)


def _drive(sensor: Sensor) -> Drive:
    config = EnvConfig(terrain="flat")
    sections = config.sim, config.robot, sensor
    rng = np.random.default_rng(0)
    return Drive(GROUND, sections, config.episode, START, _PERIOD, rng)


def _mounting(drive: Drive) -> Mounting:
    return Mounting(drive.robot, GROUND, _MARGIN, drive.world, np.random.default_rng(1))


def _perceiver(sensor: Sensor, drive: Drive) -> Perceiver:
    rngs = np.random.default_rng(2), np.random.default_rng(3)
    return Perceiver(sensor, _mounting(drive), drive.robot, rngs)


def _episode(sensor: Sensor) -> tuple[list[Perception], list[_Taken]]:
    """Return perceptions and measurements of two decisions."""
    drive = _drive(sensor)
    perceiver, taken = _perceiver(sensor, drive), list[_Taken]()

    def keep(m: Measured) -> None:
        taken.append((m.instrument, m.time, _fault(m.value)))

    perceiver.attach(drive, keep)
    perceptions = [perceiver.perceive(drive.delayed_state)]
    for _ in range(2):
        drive.decide(_RAISE)
        perceptions.append(perceiver.perceive(drive.delayed_state))
    return perceptions, taken


@cache
def _states() -> list[RobotState]:
    """Return states one decision apart."""
    drive = _drive(EnvConfig(terrain="flat").perception)
    states = [drive.state]
    for _ in range(3):
        drive.decide(_RAISE)
        states.append(drive.state)
    return states


def _perceived(perceiver: Perceiver, states: Sequence[RobotState]) -> list[Perception]:
    result = []
    for state in states:
        perceiver.measure(state)
        result.append(perceiver.perceive(state))
    return result


def _equal(first: Sequence[Perception], other: Sequence[Perception]) -> bool:
    return all(
        np.array_equal(getattr(p, name), getattr(q, name))
        for p, q in zip(first, other, strict=True)
        for name in ("observation", "points", "filled")
    )


def _fault(value: object) -> str | None:
    """Return how a measurement is not a frozen dataclass of numbers, arrays and strings."""
    if not getattr(getattr(value, "__dataclass_params__", None), "frozen", False):
        return f"{short_repr(value)}; a frozen dataclass is allowed"
    assert is_dataclass(value)
    for field in fields(value):
        part = getattr(value, field.name)
        plain = part is None or isinstance(part, bool | int | float | str | np.ndarray | np.generic)
        if not (plain or is_dataclass(part)):
            return f"{short_repr(part)} as {field.name}; numbers and arrays are allowed"
    return None
