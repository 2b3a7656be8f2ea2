"""The parts of a sensor in use, guarded: every call into what it returns goes through here.

In: a sensor and what it is mounted on. Out: instruments by name and an estimator, whose failures
and wrong values are errors that name the sensor, the method, the file and the line. A sensor that
senses once for each decision becomes one instrument here, whose measurement is the estimate.
"""

from __future__ import annotations

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
from flipperctl.env.estimates import EstimateCheck
from flipperctl.guard import naming, refusal, short_repr

T = TypeVar("T")

LONGEST = 1000
"""Most samples between two measurements of an instrument [-]."""


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


class InUse(Protocol):
    """An instrument as the environment calls it."""

    every: int | None
    """Samples between two measurements; None: one for each decision [-]."""

    def measure(self, state: RobotState, rng: np.random.Generator) -> object:
        """Return a measurement of the true state."""

    def save(self) -> Any:
        """Return a snapshot of the memory."""

    def load(self, saved: Any) -> None:
        """Return to a snapshot."""


def put_to_use(
    sensor: Sensor, mounting: Mounting, robot: RobotGeometry
) -> tuple[Mapping[str, InUse], Estimator]:
    """Return the instruments of one episode by name, and the estimator for the nominal ``robot``.

    Raises:
        PluginFailedError: the sensor's code failed, or returned a value that is not allowed.
    """
    found = sensor.instruments(mounting)
    if found is None:
        return {"sensed": GuardedSensor(sensor, mounting)}, Newest()
    if not (isinstance(found, Mapping) and all(isinstance(name, str) for name in found)):
        text = f"returned {short_repr(found)}; a mapping of names to instruments is allowed"
        raise refusal(sensor, "instruments", text)
    instruments = {name: GuardedInstrument(sensor, name, one) for name, one in found.items()}
    return instruments, GuardedEstimator(sensor, robot)


class GuardedInstrument:
    """An instrument whose failures name the sensor."""

    def __init__(self, sensor: Sensor, name: str, instrument: object) -> None:
        """Guard what ``sensor`` returned as the instrument ``name``.

        Raises:
            PluginFailedError: it is no instrument, or its period is not allowed.
        """
        if not isinstance(instrument, Instrument):
            text = f"returned {short_repr(instrument)} as {name!r}; an Instrument is allowed"
            raise refusal(sensor, "instruments", text)
        self._sensor, self._instrument = sensor, instrument
        self.every = _samples(sensor, instrument)

    def measure(self, state: RobotState, rng: np.random.Generator) -> object:
        """Return a measurement of the true state; noise is drawn from ``rng``."""
        return _call(self._sensor, "measure", self._instrument.measure, state, rng)

    def save(self) -> Any:
        """Return a snapshot of the memory."""
        return _call(self._sensor, "save", self._instrument.save)

    def load(self, saved: Any) -> None:
        """Return to a snapshot."""
        _call(self._sensor, "load", self._instrument.load, saved)


class GuardedEstimator:
    """An ``Estimator`` that calls the one of a sensor and checks its estimates."""

    def __init__(self, sensor: Sensor, robot: RobotGeometry) -> None:
        """Guard a new estimator.

        Raises:
            PluginFailedError: the sensor's code failed, or returned nothing that estimates.
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
        """Return to a snapshot."""
        _call(self._sensor, "load", self._estimator.load, saved)


@dataclass(frozen=True)
class Sensed:
    """What a sensor without instruments perceives at once."""

    ground: SensedGround
    angles: SensedAngles


class GuardedSensor:
    """A ``flipperctl.api.GroundSensor`` as an instrument, which measures once for each decision."""

    every: int | None = None

    def __init__(self, sensor: Sensor, mounting: Mounting) -> None:
        """Use ``sensor`` on the ground of an episode.

        Raises:
            PluginFailedError: the sensor's code failed, or returned nothing that senses.
        """
        self._sensor = sensor
        self._in_use = sensor.over(mounting.profile, mounting.margin)
        if not _has(self._in_use, "sense"):
            text = f"returned {short_repr(self._in_use)}; a flipperctl.api.GroundSensor is allowed"
            raise refusal(sensor, "over", text)
        # Names alone: to ask whether a value fits a protocol takes as long as to sense.
        remembers = _has(self._in_use, "save") and _has(self._in_use, "load")
        self._memory: Any = self._in_use if remembers else None
        self._check = EstimateCheck(sensor, "sense", type(self._in_use))

    def measure(self, state: RobotState, rng: np.random.Generator) -> Sensed:
        """Sense ground and posture from the robot's true state; noise is drawn from ``rng``.

        Raises:
            PluginFailedError: the sensor's code failed, or returned a value that is not allowed.
            NonFiniteError: a point, a height or an angle is not finite.
        """
        return Sensed(*self._check(_call(self._sensor, "sense", self._in_use.sense, state, rng)))

    def save(self) -> Any:
        """Return a snapshot of the memory, if there is one."""
        return None if self._memory is None else _call(self._sensor, "save", self._memory.save)

    def load(self, saved: Any) -> None:
        """Return to a snapshot."""
        if self._memory is not None:
            _call(self._sensor, "load", self._memory.load, saved)


class Newest:
    """The ``Estimator`` of a sensor without instruments: its newest measurement."""

    def __init__(self) -> None:
        self._newest: Sensed | None = None

    def update(self, measured: Measured) -> None:
        """Remember the measurement."""
        assert isinstance(measured.value, Sensed)  # of the only instrument that it is used with
        self._newest = measured.value

    def estimate(self, time: float) -> tuple[SensedGround, SensedAngles]:
        """Return the newest measurement."""
        assert self._newest is not None  # there is a measurement before each estimate
        return self._newest.ground, self._newest.angles

    def save(self) -> Sensed | None:
        """Return a snapshot of the memory."""
        return self._newest

    def load(self, saved: Sensed | None) -> None:
        """Return to a snapshot."""
        self._newest = saved


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
    with naming(sensor, method):
        return call(*given)


def _has(value: object, method: str) -> bool:
    return callable(getattr(value, method, None))
