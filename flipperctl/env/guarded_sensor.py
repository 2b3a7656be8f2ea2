"""Guards around a sensor's instruments and estimator: every call into them goes through here.

In: a sensor and its mounting. Out: instruments by name and an estimator, whose ground and angles
are checked. A failure or a wrong value is an error that names the sensor, the method, the file and
the line. A sensor that senses once for each decision becomes a single instrument, whose measurement
is the estimate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np

from flipperctl.api import (
    SAMPLE_PERIOD,
    Estimator,
    Instrument,
    Measured,
    Mounting,
    RobotGeometry,
    RobotState,
    SensedAngles,
    SensedGround,
    Sensor,
)
from flipperctl.errors import FlipperctlError, NonFiniteError, PluginFailedError
from flipperctl.guard import naming, raise_named, refusal, short_repr

_NUMBERS = "fiu"
"""Kinds of numpy's types that are real numbers."""


class EstimateCheck:
    """Checks what one method returns as ground and angles."""

    def __init__(self, sensor: Sensor, method: str, owner: type) -> None:
        """``owner`` is the class that has the ``method``."""
        self._sensor, self._method, self._owner = sensor, method, owner
        self._heights = (sensor.layout.bins,)

    def __call__(self, found: Any) -> tuple[SensedGround, SensedAngles]:
        """Return ground and angles, if they are what the method returned.

        Raises:
            PluginFailedError: it is something else.
            NonFiniteError: a point, a height or an angle is not finite.
        """
        if type(found) is tuple and len(found) == 2:
            ground, angles = found
        else:
            with naming(self._sensor, self._method):  # a generator runs the plugin's code
                ground, angles = found
        self._check_ground(ground)
        self._check_angles(angles)
        return ground, angles

    def _check_ground(self, ground: object) -> None:
        if not isinstance(ground, SensedGround):
            raise self._refusal(short_repr(ground), "a SensedGround")
        points, heights, filled = ground.points, ground.heights, ground.filled
        if not (_is_array(points, _NUMBERS) and points.ndim == 2 and points.shape[1] == 2):
            raise self._refusal(f"points {_text(points)}", "numbers of the shape (P, 2)")
        if not (_is_array(heights, _NUMBERS) and heights.shape == self._heights):
            allowed = f"numbers of the shape {self._heights}"
            raise self._refusal(f"heights {_text(heights)}", allowed)
        if filled is not None and not (_is_array(filled, "b") and filled.shape == (len(points),)):
            allowed = f"None, or booleans of the shape {(len(points),)}"
            raise self._refusal(f"filled {_text(filled)}", allowed)
        self._check_optional("seen", ground.seen, "b", self._heights)
        self._check_optional("position", ground.position, _NUMBERS, (2,))
        self._check_optional("deviation", ground.deviation, _NUMBERS, self._heights)
        if ground.deviation is not None and not (ground.deviation >= 0).all():  # nor NaN
            raise self._refusal("a deviation that is negative or NaN", "0 or more, or infinity")
        checked = [("points", points), ("heights", heights)]
        if ground.position is not None:
            checked.append(("position", ground.position))
        for name, numbers in checked:
            if not np.isfinite(numbers).all():
                raise self._refusal(f"{name} that are not finite", "finite numbers", NonFiniteError)

    def _check_optional(self, name: str, found: Any, kinds: str, shape: tuple[int, ...]) -> None:
        if found is not None and not (_is_array(found, kinds) and found.shape == shape):
            kind = "booleans" if kinds == "b" else "numbers"
            raise self._refusal(f"{name} {_text(found)}", f"None, or {kind} of the shape {shape}")

    def _check_angles(self, angles: object) -> None:
        if not isinstance(angles, SensedAngles):
            raise self._refusal(short_repr(angles), "SensedAngles")
        try:
            finite = all(map(math.isfinite, (angles.front, angles.rear, angles.pitch)))
        except (TypeError, ValueError, OverflowError) as error:
            raise self._refusal(short_repr(angles), "three numbers") from error
        if not finite:
            raise self._refusal(short_repr(angles), "three finite numbers", NonFiniteError)

    def _refusal(
        self, found: str, allowed: str, raised: type[FlipperctlError] = PluginFailedError
    ) -> FlipperctlError:
        text = f"returned {found}; allowed: {allowed}"
        return refusal(self._sensor, self._method, text, raised, owner=self._owner)


def _is_array(value: Any, kinds: str) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind in kinds


def _text(value: Any) -> str:
    """Return the type and the shape of an array, or the ``repr`` of another value."""
    if isinstance(value, np.ndarray):
        return f"of the type {value.dtype} and the shape {value.shape}"
    return short_repr(value)


T = TypeVar("T")

LONGEST = 1000
"""Largest number of samples between two measurements of an instrument [-]."""


def exact(sensor: Sensor) -> Sensor:
    """Return the sensor without errors, in the same layout.

    Raises:
        PluginFailedError: the sensor's code failed, or returned something else.
    """
    found = sensor.exact()
    if not isinstance(found, Sensor) or found.layout != sensor.layout:
        text = f"returned {short_repr(found)}; a Sensor of the same layout is allowed"
        raise refusal(sensor, "exact", text)
    return found


class MountedInstrument(Protocol):
    """An instrument of one episode, as the environment calls it."""

    every: int | None
    """Samples between two measurements; None: one for each decision [-]."""

    def measure(self, state: RobotState, rng: np.random.Generator) -> object:
        """Return a measurement of the true state, or None."""

    def save(self) -> Any:
        """Return a snapshot of the memory."""

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""


def mounted_parts(
    sensor: Sensor, mounting: Mounting, robot: RobotGeometry
) -> tuple[Mapping[str, MountedInstrument], Estimator]:
    """Return the instruments of one episode by name, and the estimator for the nominal ``robot``.

    Raises:
        PluginFailedError: the sensor's code failed, or returned a value that is not allowed.
    """
    found = sensor.instruments(mounting)
    if found is None:
        return {"sensed": GuardedSensor(sensor, mounting)}, LatestMeasurement()
    if not (isinstance(found, Mapping) and all(isinstance(name, str) for name in found)):
        text = f"returned {short_repr(found)}; a mapping of names to instruments is allowed"
        raise refusal(sensor, "instruments", text)
    instruments = {name: GuardedInstrument(sensor, name, one) for name, one in found.items()}
    return instruments, GuardedEstimator(sensor, robot)


class GuardedInstrument:
    """An instrument whose failures name the sensor."""

    def __init__(self, sensor: Sensor, name: str, instrument: object) -> None:
        """Guard the object that ``sensor`` returned as the instrument ``name``.

        Raises:
            PluginFailedError: it is not an instrument, or its period is not allowed.
        """
        if not isinstance(instrument, Instrument):
            text = f"returned {short_repr(instrument)} as {name!r}; an Instrument is allowed"
            raise refusal(sensor, "instruments", text)
        self._sensor, self._instrument = sensor, instrument
        self.every = _samples(sensor, instrument)

    def measure(self, state: RobotState, rng: np.random.Generator) -> object:
        """Return a measurement of the true state, or None; noise is drawn from ``rng``."""
        return _call(self._sensor, "measure", self._instrument.measure, state, rng)

    def save(self) -> Any:
        """Return a snapshot of the memory."""
        return _call(self._sensor, "save", self._instrument.save)

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
        _call(self._sensor, "load", self._instrument.load, saved)


class GuardedEstimator:
    """An ``Estimator`` that calls a sensor's estimator and checks its estimates."""

    def __init__(self, sensor: Sensor, robot: RobotGeometry) -> None:
        """Guard a new estimator.

        Raises:
            PluginFailedError: the sensor's code failed, or did not return an estimator.
        """
        self._sensor = sensor
        self._estimator: Estimator = sensor.estimator(robot)
        needed = ("update", "estimate", "save", "load")
        missing = [method for method in needed if not _has(self._estimator, method)]
        if missing:
            text = f"returned {short_repr(self._estimator)}, which has no {', '.join(missing)}"
            raise refusal(sensor, "estimator", f"{text}; a flipperctl.api.Estimator is allowed")
        self._check = EstimateCheck(sensor, "estimate", type(self._estimator))

    def update(self, measured: Measured) -> None:
        """Receive a measurement."""
        _call(self._sensor, "update", self._estimator.update, measured)

    def estimate(self, time: float) -> tuple[SensedGround, SensedAngles]:
        """Return the estimate for a ``time`` [s].

        Raises:
            PluginFailedError: the sensor's code failed, or returned a value that is not allowed.
            NonFiniteError: a point, a height or an angle is not finite.
        """
        return self._check(_call(self._sensor, "estimate", self._estimator.estimate, time))

    def save(self) -> Any:
        """Return a snapshot of the memory."""
        return _call(self._sensor, "save", self._estimator.save)

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
        _call(self._sensor, "load", self._estimator.load, saved)


@dataclass(frozen=True)
class Sensed:
    """A measurement of a sensor without instruments."""

    ground: SensedGround
    angles: SensedAngles


class GuardedSensor:
    """A ``flipperctl.api.GroundSensor`` as an instrument that measures once for each decision."""

    every: int | None = None

    def __init__(self, sensor: Sensor, mounting: Mounting) -> None:
        """Set up ``sensor`` for the ground of an episode.

        Raises:
            PluginFailedError: the sensor's code failed, or did not return a ``GroundSensor``.
        """
        made = sensor.over(mounting.profile, mounting.margin)
        if not _has(made, "sense"):
            text = f"returned {short_repr(made)}; a flipperctl.api.GroundSensor is allowed"
            raise refusal(sensor, "over", text)
        self._sensor, self._ground_sensor = sensor, made
        # Names alone: to ask whether a value fits a protocol takes as long as to sense.
        remembers = _has(made, "save") and _has(made, "load")
        self._memory: Any = made if remembers else None
        self._check = EstimateCheck(sensor, "sense", type(made))

    def measure(self, state: RobotState, rng: np.random.Generator) -> Sensed:
        """Sense ground and posture from the robot's true state; noise is drawn from ``rng``.

        Raises:
            PluginFailedError: the sensor's code failed, or returned a value that is not allowed.
            NonFiniteError: a point, a height or an angle is not finite.
        """
        found = _call(self._sensor, "sense", self._ground_sensor.sense, state, rng)
        return Sensed(*self._check(found))

    def save(self) -> Any:
        """Return a snapshot of the memory, if there is one."""
        return None if self._memory is None else _call(self._sensor, "save", self._memory.save)

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
        if self._memory is not None:
            _call(self._sensor, "load", self._memory.load, saved)


class LatestMeasurement:
    """The ``Estimator`` of a sensor without instruments, its latest measurement."""

    def __init__(self) -> None:
        self._latest: Sensed | None = None

    def update(self, measured: Measured) -> None:
        """Remember the measurement."""
        assert isinstance(measured.value, Sensed)  # from the only instrument
        self._latest = measured.value

    def estimate(self, time: float) -> tuple[SensedGround, SensedAngles]:
        """Return the latest measurement."""
        assert self._latest is not None  # there is a measurement before each estimate
        return self._latest.ground, self._latest.angles

    def save(self) -> Sensed | None:
        """Return a snapshot of the memory."""
        return self._latest

    def load(self, saved: Sensed | None) -> None:
        """Restore a snapshot."""
        self._latest = saved


def _samples(sensor: Sensor, instrument: Instrument) -> int | None:
    """Return the period of an instrument in samples; None: once for each decision."""
    period: object = instrument.period
    if period is None:
        return None
    if isinstance(period, int | float) and 0 < period <= LONGEST * SAMPLE_PERIOD:
        samples = round(period / SAMPLE_PERIOD)
        if samples and abs(samples * SAMPLE_PERIOD - period) < 1e-9:
            return samples
    raise refusal(
        sensor,
        "period",
        f"is {short_repr(period)}; None is allowed, or a whole multiple of {SAMPLE_PERIOD:g} s "
        f"up to {LONGEST * SAMPLE_PERIOD:g} s",
        owner=type(instrument),
    )


def _call(sensor: Sensor, method: str, call: Callable[..., T], *given: Any) -> T:
    try:  # not ``naming``, since there are calls in each decision
        return call(*given)
    except BaseException as error:  # noqa: BLE001  # raised again
        raise_named(error, sensor, method)


def _has(value: object, method: str) -> bool:
    return callable(getattr(value, method, None))
