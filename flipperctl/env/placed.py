"""What engines and sensors build for an episode, as the environment uses it.

In: an engine with the arguments of ``place``, or a sensor and its mounting. Out: a world whose
numbers are finite, or instruments by name and an estimator. A sensor that senses once for each
decision becomes a single instrument, whose measurement is the estimate. ``checked``: whether every
value is checked, as in the first episode.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any

import numpy as np

from flipperctl.api import (
    NO_LIMITS,
    BeltWorld,
    CameraWorld,
    EndingWorld,
    Engine,
    Estimator,
    FloatArray,
    Instrument,
    Limits,
    Measured,
    Mounting,
    Outcome,
    Plugin,
    PoweredWorld,
    Profile,
    RayWorld,
    Robot,
    RobotGeometry,
    RobotState,
    RollingWorld,
    SensedAngles,
    SensedGround,
    Sensor,
    Start,
)
from flipperctl.core.targets import angles_of
from flipperctl.errors import ConfigError, FlipperctlError, NonFiniteError
from flipperctl.plugging.checked import Checked, require
from flipperctl.plugging.guard import refusal

_scalars = attrgetter(
    *("pitch", "front", "rear", "pitch_rate", "time", "roll", "yaw", "side", "side_velocity")
)


def place(
    engine: Engine,
    profile: Profile,
    robot: Robot,
    start: Start,
    rng: np.random.Generator,
    *,
    checked: bool = True,
) -> PlacedWorld:
    """Return the world that ``engine`` places.

    Raises:
        PluginFailedError: the engine did not return a world.
    """
    world = require(engine, "place", engine.place(profile, robot, start, rng))
    return PlacedWorld(engine, world, checked=checked)


_ABILITIES = {
    "run_belts": (BeltWorld, "an operator changes the belts' speed, which sim={} cannot"),
    "cast_rays": (RayWorld, "perception: the sensor casts rays, which sim={} cannot"),
    "look": (CameraWorld, "perception: the sensor has a camera, which sim={} lacks"),
}
"""Method that a world need not have → its protocol, and why an engine without it is refused."""


_SUMS = {PoweredWorld: "flipper_work", RollingWorld: "roll_variation"}
"""Protocol that a world need not follow → its method, which returns a sum since the start."""


class PlacedWorld:
    """The world of an engine; a ``flipperctl.api.DrawingWorld`` if the engine's is one.

    Poses, states and sums that are not finite are a ``NonFiniteError``; a method of ``_ABILITIES``
    that the engine lacks is a ``ConfigError``. Everything else is the engine's own.
    """

    def __init__(self, engine: Engine, world: Any, *, checked: bool) -> None:
        """``world``: what ``engine`` placed."""
        self.engine, self.of_engine = engine, world
        self._world = Checked(engine, world) if checked else world
        # Once, since the check of a protocol takes long compared with a decision.
        self._terminates = isinstance(world, EndingWorld)
        self._summed = tuple(name for p, name in _SUMS.items() if isinstance(world, p))
        self.command = self._world.command
        """Set the target angles of the flippers; see ``flipperctl.api.World``."""

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the engine's world."""
        if name[0] == "_":  # of a copy that is not set up yet
            raise AttributeError(name)
        if name in _ABILITIES and not hasattr(self.of_engine, name):
            protocol, text = _ABILITIES[name]
            raise ConfigError(
                f"{text.format(self.engine.plugin_name)}; choose an engine whose world is a "
                f"flipperctl.api.{protocol.__name__}"
            )
        return getattr(self._world, name)

    def advance(self, samples: int, limits: Limits = NO_LIMITS) -> FloatArray:
        """Simulate up to ``samples`` sample periods; return the poses, at least one."""
        poses: FloatArray = self._world.advance(samples, limits)
        if not 0 < len(poses) <= samples:  # none would not end
            text = f"returned {len(poses)} poses; allowed: 1 to {samples}"
            raise refusal(self.engine, "advance", text, owner=type(self.of_engine))
        if not _are_finite(poses):
            raise _not_finite(self.engine, "advance", "NaN or infinity in a pose", self.of_engine)
        return poses

    def state(self) -> RobotState:
        """Return the current state."""
        state: RobotState = self._world.state()
        # NaN and infinity stay in a sum.
        total = sum(_scalars(state)) + sum(state.position.tolist()) + sum(state.velocity.tolist())
        total += sum(state.flippers)
        for array in (state.orientation, state.belts):
            if array is not None:
                total += float(array.sum())
        if not math.isfinite(total):
            parts = {f.name: getattr(state, f.name) for f in fields(state)}
            shown = (f"{v} as {name}" for name, v in parts.items() if not _are_finite(v))
            raise _not_finite(self.engine, "state", " and ".join(shown), self.of_engine)
        return state

    def ended(self) -> Outcome | None:
        """Return the outcome if the world has terminated by itself, else None."""
        return self._world.ended() if self._terminates else None

    def sums(self) -> tuple[float | None, ...]:
        """Return the flippers' work [J] and the roll variation [rad] since the start.

        None: not measured.
        """
        values = tuple(
            getattr(self._world, name)() if name in self._summed else None
            for name in _SUMS.values()
        )
        for name, value in zip(_SUMS.values(), values, strict=True):
            if value is not None and not math.isfinite(value):
                raise _not_finite(self.engine, name, str(value), self.of_engine)
        return values


def mounted_parts(
    sensor: Sensor, mounting: Mounting, robot: RobotGeometry, *, checked: bool = True
) -> tuple[Mapping[str, Instrument], Estimator, object]:
    """Return the instruments of one episode by name, the estimator, and what of the sensor senses.

    ``robot``: the nominal one, which the estimator knows.

    Raises:
        PluginFailedError: the sensor returned a value that is not allowed.
    """
    instruments = require(sensor, "instruments", sensor.instruments(mounting))
    if instruments is None:
        ground = require(sensor, "over", sensor.mounted(mounting))
        whole = _WholeSensor(Checked(sensor, ground) if checked else ground)
        return {"sensed": whole}, LatestMeasurement(), ground
    built = require(sensor, "estimator", sensor.estimator(robot))
    return instruments, Checked(sensor, built) if checked else built, built


def require_sensed_finite(
    sensor: Sensor, senses: object, ground: SensedGround, angles: SensedAngles
) -> None:
    """Refuse numbers that are not finite, which the object ``senses`` of the sensor returned."""
    posture = math.fsum((*angles_of(angles), angles.pitch, angles.roll))
    total = posture
    for array in (ground.points, ground.heights, ground.position):
        if array is not None:
            total += float(np.vdot(array, array))
    # Large numbers may overflow in the sum; each is looked at only then.
    if math.isfinite(total):
        return
    numbers = ("points", "heights", "position")
    faults = [name for name in numbers if not _are_finite(getattr(ground, name))]
    if not math.isfinite(posture):
        faults.append("angles")
    if faults:
        method = "sense" if hasattr(senses, "sense") else "estimate"
        text = f"NaN or infinity in {' and '.join(faults)}"
        raise _not_finite(sensor, method, text, senses)


def _not_finite(plugin: Plugin, method: str, what: str, built: object) -> FlipperctlError:
    text = f"returned {what}; finite numbers are allowed"
    return refusal(plugin, method, text, NonFiniteError, owner=type(built))


def _are_finite(numbers: Any) -> bool:
    """Return whether all numbers are finite; None is."""
    # The sum of squares, which takes a third of numpy's time for all numbers, may overflow.
    return (
        numbers is None
        or math.isfinite(np.vdot(numbers, numbers))
        or bool(np.isfinite(numbers).all())
    )


@dataclass(frozen=True)
class Sensed:
    """A measurement of a sensor without instruments."""

    ground: SensedGround
    angles: SensedAngles


class _WholeSensor(Instrument):
    """A ``flipperctl.api.GroundSensor`` as an instrument that measures once for each decision."""

    def __init__(self, ground: Any) -> None:
        self._ground = ground
        # Names alone: to ask whether a value fits a protocol takes as long as to sense.
        self._remembers = all(hasattr(ground, name) for name in ("save", "load"))

    def measure(self, state: RobotState, rng: np.random.Generator) -> Sensed:
        """Sense ground and posture from the robot's true state; noise is drawn from ``rng``."""
        return Sensed(*self._ground.sense(state, rng))

    def save(self) -> Any:
        """Return a snapshot of the memory, if there is one."""
        return self._ground.save() if self._remembers else None

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
        if self._remembers:
            self._ground.load(saved)


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
