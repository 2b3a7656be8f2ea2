"""Guards around what engines and sensors build: every call into it goes through here.

In: an engine with the arguments of ``place``, or a sensor and its mounting. Out: a
``flipperctl.api.World``, or instruments by name and an estimator. A failure or a wrong value is an
error that names the plugin, the method, the file and the line. A sensor that senses once for each
decision becomes a single instrument, whose measurement is the estimate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    NO_LIMITS,
    SAMPLE_PERIOD,
    BeltWorld,
    CameraImage,
    CameraWorld,
    DrawingWorld,
    EndingWorld,
    Engine,
    Estimator,
    FloatArray,
    Instrument,
    Limits,
    Measured,
    Mounting,
    Outcome,
    PoweredWorld,
    Profile,
    RayWorld,
    Robot,
    RobotGeometry,
    RobotState,
    SensedAngles,
    SensedGround,
    Sensor,
    Start,
    View,
    World,
)
from flipperctl.errors import ConfigError, NonFiniteError
from flipperctl.plugging.guard import Guarded, naming, refusal, short_repr

_METHODS = ("command", "advance", "state", "penetration", "save", "load")
_VECTORS = ("position", "velocity")
_SCALARS = ("pitch", "front", "rear", "pitch_rate", "time", "roll", "yaw", "side", "side_velocity")
_scalars, _vectors = attrgetter(*_SCALARS), attrgetter(*_VECTORS)
_ARRAYS = (("orientation", (3, 3)), ("belts", (2,)))
"""Names and shapes of the arrays that may be None."""
_ground = attrgetter("points", "heights", "position", "filled", "seen", "deviation")
_STATE = "a RobotState of numbers, with two in each vector and 3 × 3 in the orientation"
_NUMBERS = "fiu"
"""Kinds of numpy's types that are real numbers."""
LONGEST = 1000
"""Largest number of samples between two measurements of an instrument [-]."""


def place(
    engine: Engine, profile: Profile, robot: Robot, start: Start, rng: np.random.Generator
) -> GuardedWorld:
    """Return the guarded world that ``engine`` places, a ``DrawingWorld`` if the engine's is one.

    Raises:
        PluginFailedError: the engine's code failed, or did not return a world.
    """
    with naming(engine, "place"):  # the returned object's code may fail too
        world = engine.place(profile, robot, start, rng)
        missing = [name for name in _METHODS if not hasattr(world, name)]
        draws = isinstance(world, DrawingWorld)
    if missing:
        text = f"returned {short_repr(world)}, which has no {', '.join(missing)}"
        raise refusal(engine, "place", f"{text}; a flipperctl.api.World is allowed")
    return GuardedDrawingWorld(engine, world) if draws else GuardedWorld(engine, world)


class GuardedWorld(Guarded):
    """A ``flipperctl.api.World`` that calls the world of an engine.

    Every method raises ``PluginFailedError`` if the engine's code failed or returned a value that
    the contract does not allow, and ``NonFiniteError`` if a number is not finite.
    """

    def __init__(self, engine: Engine, world: World) -> None:
        """Guard ``world``, which ``engine`` placed."""
        super().__init__(engine, world)
        # Once, since the check of a protocol takes long compared with a decision.
        self._terminates = isinstance(world, EndingWorld)
        self._is_powered = isinstance(world, PoweredWorld)

    @property
    def position(self) -> tuple[float, float]:
        """World coordinates (x, z) of the chassis centre [m]."""
        with naming(self.plugin, "position"):
            x, z = self.unguarded.position
        self._require_finite("position", (x, z), ("x", "z"))
        return float(x), float(z)

    @property
    def pitch(self) -> float:
        """Pitch of the chassis, nose up positive [rad]."""
        with naming(self.plugin, "pitch"):
            pitch = self.unguarded.pitch
        return self._finite("pitch", pitch, "pitch")

    def command(self, front: float, rear: float) -> None:
        """Set the target angles of the flippers in frame R [rad]."""
        self.call("command", front, rear)

    def advance(self, samples: int, limits: Limits = NO_LIMITS) -> FloatArray:
        """Simulate up to ``samples`` sample periods; return the poses, (S, 5), at least one."""
        poses = self.call("advance", samples, limits)
        if not (isinstance(poses, np.ndarray) and poses.dtype.kind in _NUMBERS):
            raise self.refusal("advance", short_repr(poses), "an array of numbers")
        if poses.ndim != 2 or poses.shape[1] != 5 or not 0 < len(poses) <= samples:
            allowed = f"1 to {samples} rows of 5 numbers"
            raise self.refusal("advance", f"an array of the shape {poses.shape}", allowed)
        if not _are_finite(poses):
            for pose in poses.tolist():
                self._require_finite("advance", pose, ("x", "z", "pitch", "front", "rear"))
        return poses

    def state(self) -> RobotState:
        """Return the current state."""
        state = self.call("state")
        try:
            numbers = [*_scalars(state)]
            for vector in _vectors(state):
                x, z = vector.tolist()
                numbers += x, z
            for name, shape in _ARRAYS:
                if (array := getattr(state, name)) is not None:
                    if array.shape != shape:
                        raise self.refusal("state", short_repr(state), _STATE)
                    numbers += array.ravel().tolist()
            finite = all(map(math.isfinite, numbers))
        except (AttributeError, TypeError, ValueError, OverflowError) as error:
            raise self.refusal("state", short_repr(state), _STATE) from error
        if not isinstance(state, RobotState):
            raise self.refusal("state", short_repr(state), _STATE)
        if not finite:
            components = [f"{name}'s {axis}" for name in _VECTORS for axis in "xz"]
            self._require_finite("state", numbers, (*_SCALARS, *components))
        return state

    def penetration(self) -> float:
        """Return the largest depth by which the robot overlaps the ground [m]."""
        return self._finite("penetration", self.call("penetration"), "depth")

    def ended(self) -> Outcome | None:
        """Return the outcome if the world has terminated by itself, else None."""
        outcome = self.call("ended") if self._terminates else None
        if outcome is not None and not isinstance(outcome, Outcome):
            raise self.refusal("ended", short_repr(outcome), "an Outcome, or None")
        return outcome

    def flipper_work(self) -> float | None:
        """Return the work of the flippers' motors since the start [J]; None: not measured."""
        if not self._is_powered:
            return None
        return self._finite("flipper_work", self.call("flipper_work"), "work")

    def run_belts(self, share: float) -> None:
        """Run the belts at a share of their speed; ``ConfigError`` if the engine cannot."""
        self._require_ability(
            BeltWorld, "an operator changes the belts' speed, which sim={} cannot"
        )
        self.call("run_belts", share)

    def cast_rays(self, origin: FloatArray, directions: FloatArray, reach: float) -> FloatArray:
        """Return the distance from ``origin`` to the ground along each direction, (R,) [m].

        See ``flipperctl.api.RayWorld``; ``ConfigError`` if the engine casts no rays.
        """
        self._require_ability(RayWorld, "perception: the sensor casts rays, which sim={} cannot")
        found: FloatArray = self.call("cast_rays", origin, directions, reach)
        allowed = f"distances ≥ 0 of the shape {(len(directions),)}"
        self._require_array("cast_rays", found, "f", (len(directions),), allowed)
        if not (found >= 0).all():  # false for NaN
            text = f"the distance {found[~(found >= 0)][0]:g}"
            raise self.refusal("cast_rays", text, allowed)
        return found

    def look(self, view: View, width: int, height: int) -> CameraImage:
        """Return what a camera of the robot shows; see ``flipperctl.api.CameraWorld``.

        ``ConfigError`` if the engine has no cameras.
        """
        self._require_ability(
            CameraWorld, "perception: the sensor has a camera, which sim={} lacks"
        )
        image = self.call("look", view, width, height)
        shapes = (height, width, 3), (height, width)
        if not isinstance(image, CameraImage) or shapes != (image.pixels.shape, image.depth.shape):
            allowed = f"a CameraImage of {height} × {width} pixels"
            raise self.refusal("look", short_repr(image), allowed)
        return image

    def _require_ability(self, protocol: type, text: str) -> None:
        if not isinstance(self.unguarded, protocol):
            raise ConfigError(
                f"{text.format(self.plugin.plugin_name)}; choose an engine whose "
                f"world is a flipperctl.api.{protocol.__name__}"
            )

    def _require_array(
        self, method: str, found: Any, kind: str, shape: tuple[int, ...], allowed: str
    ) -> None:
        if not (isinstance(found, np.ndarray) and found.dtype.kind == kind):
            raise self.refusal(method, short_repr(found), allowed)
        if found.shape != shape:
            raise self.refusal(method, f"an array of the shape {found.shape}", allowed)

    def _finite(self, method: str, number: Any, name: str) -> float:
        self._require_finite(method, (number,), (name,))
        return float(number)

    def _require_finite(self, method: str, numbers: Sequence[Any], names: Sequence[str]) -> None:
        for name, number in zip(names, numbers, strict=True):
            try:
                finite = math.isfinite(number)
            except (TypeError, ValueError, OverflowError) as error:
                found = f"{short_repr(number)} as {name}"
                raise self.refusal(method, found, "a number") from error
            if not finite:
                found, allowed = f"{number} as {name}", "a finite number"
                raise self.refusal(method, found, allowed, NonFiniteError)


class GuardedDrawingWorld(GuardedWorld):
    """A guarded ``flipperctl.api.DrawingWorld``."""

    def draw(self, width: int, height: int) -> NDArray[np.uint8]:
        """Return a picture of the current state, (H, W, 3)."""
        picture: NDArray[np.uint8] = self.call("draw", width, height)
        allowed = f"an array of uint8 of the shape {(height, width, 3)}"
        if getattr(picture, "dtype", None) != np.uint8:
            raise self.refusal("draw", short_repr(picture), allowed)
        self._require_array("draw", picture, "u", (height, width, 3), allowed)
        return picture


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


def mounted_parts(
    sensor: Sensor, mounting: Mounting, robot: RobotGeometry
) -> tuple[Mapping[str, GuardedInstrument | GuardedSensor], Estimator]:
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


class GuardedInstrument(Guarded):
    """An instrument whose failures name the sensor."""

    def __init__(self, sensor: Sensor, name: str, instrument: object) -> None:
        """Guard the object that ``sensor`` returned as the instrument ``name``."""
        if not isinstance(instrument, Instrument):
            text = f"returned {short_repr(instrument)} as {name!r}; an Instrument is allowed"
            raise refusal(sensor, "instruments", text)
        super().__init__(sensor, instrument)
        period: Any = instrument.period
        possible = isinstance(period, int | float) and 0 < period <= LONGEST * SAMPLE_PERIOD
        samples = round(period / SAMPLE_PERIOD) if possible else 0
        if period is not None and not (samples and abs(samples * SAMPLE_PERIOD - period) < 1e-9):
            text = (
                f"is {short_repr(period)}; None is allowed, or a whole multiple of "
                f"{SAMPLE_PERIOD:g} s up to {LONGEST * SAMPLE_PERIOD:g} s"
            )
            raise refusal(sensor, "period", text, owner=type(instrument))
        self.every = samples or None
        """Samples between two measurements; None: one for each decision [-]."""

    def measure(self, state: RobotState, rng: np.random.Generator) -> object:
        """Return a measurement of the true state, or None; noise is drawn from ``rng``."""
        return self.call("measure", state, rng)


class _Sensing(Guarded):
    """An object with a method that returns ground and angles, which are checked."""

    def __init__(self, sensor: Sensor, built: object) -> None:
        super().__init__(sensor, built)
        self._bins, self._heights = (sensor.layout.bins,), (sensor.layout.heights,)

    def _sensed(self, method: str, *given: Any) -> tuple[SensedGround, SensedAngles]:
        found = self.call(method, *given)
        if type(found) is tuple and len(found) == 2:
            ground, angles = found
        else:
            with naming(self.plugin, method):  # a generator runs the plugin's code
                ground, angles = found
        if not isinstance(ground, SensedGround):
            raise self.refusal(method, short_repr(ground), "a SensedGround")
        points, heights, position, filled, seen, deviation = _ground(ground)
        bins = self._bins
        self._check(method, "points", points, _NUMBERS, None)
        if heights is not None:
            self._check(method, "heights", heights, _NUMBERS, self._heights, optional=True)
        if filled is not None:
            self._check(method, "filled", filled, "b", (len(points),), optional=True)
        if seen is not None:
            self._check(method, "seen", seen, "b", bins, optional=True)
        if position is not None:
            self._check(method, "position", position, _NUMBERS, (2,), optional=True)
        if deviation is not None:
            self._check(method, "deviation", deviation, _NUMBERS, bins, optional=True)
        if deviation is not None and not (deviation >= 0).all():  # nor NaN
            found, allowed = "a deviation that is negative or NaN", "0 or more, or infinity"
            raise self.refusal(method, found, allowed)
        for name, numbers in (("points", points), ("heights", heights), ("position", position)):
            if numbers is not None and not _are_finite(numbers):
                found = f"{name} that are not finite"
                raise self.refusal(method, found, "finite numbers", NonFiniteError)
        if not isinstance(angles, SensedAngles):
            raise self.refusal(method, short_repr(angles), "SensedAngles")
        try:
            finite = all(map(math.isfinite, (angles.front, angles.rear, angles.pitch)))
        except (TypeError, ValueError, OverflowError) as error:
            raise self.refusal(method, short_repr(angles), "three numbers") from error
        if not finite:
            found = short_repr(angles)
            raise self.refusal(method, found, "three finite numbers", NonFiniteError)
        return ground, angles

    def _check(
        self,
        method: str,
        name: str,
        value: Any,
        kinds: str,
        shape: tuple[int, ...] | None,
        *,
        optional: bool = False,
    ) -> None:
        """Refuse an array of another kind or ``shape``; None: (P, 2)."""
        if is_array := isinstance(value, np.ndarray):
            fits = value.shape[1:] == (2,) if shape is None else value.shape == shape
            if fits and value.dtype.kind in kinds:
                return
        text = f"of the type {value.dtype} and the shape {value.shape}" if is_array else ""
        kind = "booleans" if kinds == "b" else "numbers"
        allowed = f"{'None, or ' if optional else ''}{kind} of the shape {shape or '(P, 2)'}"
        raise self.refusal(method, f"{name} {text or short_repr(value)}", allowed)


class GuardedEstimator(_Sensing):
    """An ``Estimator`` that calls a sensor's estimator and checks its estimates."""

    def __init__(self, sensor: Sensor, robot: RobotGeometry) -> None:
        """Guard a new estimator for the nominal ``robot``."""
        super().__init__(sensor, sensor.estimator(robot))
        needed = ("update", "estimate", "save", "load")
        if missing := [method for method in needed if not _has(self.unguarded, method)]:
            text = f"returned {short_repr(self.unguarded)}, which has no {', '.join(missing)}"
            raise refusal(sensor, "estimator", f"{text}; a flipperctl.api.Estimator is allowed")

    def update(self, measured: Measured) -> None:
        """Receive a measurement."""
        self.call("update", measured)

    def estimate(self, time: float) -> tuple[SensedGround, SensedAngles]:
        """Return the estimate for a ``time`` [s]."""
        return self._sensed("estimate", time)


@dataclass(frozen=True)
class Sensed:
    """A measurement of a sensor without instruments."""

    ground: SensedGround
    angles: SensedAngles


class GuardedSensor(_Sensing):
    """A ``flipperctl.api.GroundSensor`` as an instrument that measures once for each decision."""

    every: int | None = None

    def __init__(self, sensor: Sensor, mounting: Mounting) -> None:
        """Set up ``sensor`` for the ground of an episode."""
        made = sensor.over(mounting.profile, mounting.margin)
        if not _has(made, "sense"):
            text = f"returned {short_repr(made)}; a flipperctl.api.GroundSensor is allowed"
            raise refusal(sensor, "over", text)
        super().__init__(sensor, made)
        # Names alone: to ask whether a value fits a protocol takes as long as to sense.
        self._remembers = _has(made, "save") and _has(made, "load")

    def measure(self, state: RobotState, rng: np.random.Generator) -> Sensed:
        """Sense ground and posture from the robot's true state; noise is drawn from ``rng``."""
        return Sensed(*self._sensed("sense", state, rng))

    def save(self) -> Any:
        """Return a snapshot of the memory, if there is one."""
        return super().save() if self._remembers else None

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
        if self._remembers:
            super().load(saved)


class LatestMeasurement:
    """The ``Estimator`` of a sensor without instruments, its latest measurement."""

    def __init__(self) -> None:
        self._latest: Any = None

    def update(self, measured: Measured) -> None:
        """Remember the measurement."""
        self._latest = measured.value

    def estimate(self, time: float) -> tuple[SensedGround, SensedAngles]:
        """Return the latest measurement."""
        return self._latest.ground, self._latest.angles

    def save(self) -> Any:
        """Return a snapshot of the memory."""
        return self._latest

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
        self._latest = saved


def _are_finite(numbers: FloatArray) -> bool:
    """Return whether all numbers are finite, sooner than numpy's own ``all``."""
    return bool(np.logical_and.reduce(np.isfinite(numbers), axis=None))


def _has(value: object, method: str) -> bool:
    return callable(getattr(value, method, None))
