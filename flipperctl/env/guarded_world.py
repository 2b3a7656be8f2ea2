"""A guard around an engine's world: every call into a plugin's simulation goes through here.

In: an engine, a profile, a robot, a start and a generator. Out: a ``flipperctl.api.World``. A
failure or a wrong value is an error that names the engine, the method, the file and the line.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    NO_LIMITS,
    CameraImage,
    CameraWorld,
    DrawingWorld,
    EndingWorld,
    Engine,
    FloatArray,
    Limits,
    Outcome,
    PoweredWorld,
    Profile,
    RayWorld,
    Robot,
    RobotState,
    Start,
    View,
    World,
)
from flipperctl.errors import ConfigError, FlipperctlError, NonFiniteError, PluginFailedError
from flipperctl.guard import naming, raise_named, refusal, short_repr

_METHODS = ("command", "advance", "state", "penetration", "save", "load")
_VECTORS = ("position", "velocity")
_SCALARS = ("pitch", "front", "rear", "pitch_rate", "time", "roll", "yaw", "side", "side_velocity")
_ARRAYS = (("orientation", (3, 3)), ("belts", (2,)))
"""Names and shapes of the arrays that may be None."""
_STATE = "a RobotState of numbers, with two in each vector and 3 × 3 in the orientation"


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


class GuardedWorld:
    """A ``flipperctl.api.World`` that calls the world of an engine.

    Every method raises ``PluginFailedError`` if the engine's code failed or returned a value that
    the contract does not allow, and ``NonFiniteError`` if a number is not finite.
    """

    def __init__(self, engine: Engine, world: World) -> None:
        """Guard ``world``, which ``engine`` placed."""
        self._engine = engine
        self.unguarded: Any = world
        """The engine's own world."""
        # Once, since the check of a protocol takes long compared with a decision.
        self._terminates = isinstance(world, EndingWorld)
        self._is_powered = isinstance(world, PoweredWorld)

    @property
    def position(self) -> tuple[float, float]:
        """World coordinates (x, z) of the chassis centre [m]."""
        try:
            x, z = self.unguarded.position
        except BaseException as error:  # noqa: BLE001  # raised again
            raise_named(error, self._engine, "position")
        self._require_finite("position", (x, z), ("x", "z"))
        return float(x), float(z)

    @property
    def pitch(self) -> float:
        """Pitch of the chassis, nose up positive [rad]."""
        with naming(self._engine, "pitch"):
            pitch = self.unguarded.pitch
        self._require_finite("pitch", (pitch,), ("pitch",))
        return float(pitch)

    def command(self, front: float, rear: float) -> None:
        """Set the target angles of the flippers in frame R [rad]."""
        self._call("command", front, rear)

    def advance(self, samples: int, limits: Limits = NO_LIMITS) -> FloatArray:
        """Simulate up to ``samples`` sample periods; return the poses, (S, 5), at least one."""
        poses = self._call("advance", samples, limits)
        if not (isinstance(poses, np.ndarray) and poses.dtype.kind in "fiu"):
            raise self._refusal("advance", short_repr(poses), "an array of numbers")
        if poses.ndim != 2 or poses.shape[1] != 5 or not 0 < len(poses) <= samples:
            allowed = f"1 to {samples} rows of 5 numbers"
            raise self._refusal("advance", f"an array of the shape {poses.shape}", allowed)
        if not np.isfinite(poses).all():
            names = ("x", "z", "pitch", "front", "rear")
            for pose in poses.tolist():
                self._require_finite("advance", pose, names)
        return poses

    def state(self) -> RobotState:
        """Return the current state."""
        state = self._call("state")
        try:
            numbers = [getattr(state, name) for name in _SCALARS]
            for name in _VECTORS:
                x, z = getattr(state, name).tolist()
                numbers += x, z
            for name, shape in _ARRAYS:
                if (array := getattr(state, name)) is not None:
                    if array.shape != shape:
                        raise self._refusal("state", short_repr(state), _STATE)
                    numbers += array.ravel().tolist()
            finite = all(map(math.isfinite, numbers))
        except (AttributeError, TypeError, ValueError, OverflowError) as error:
            raise self._refusal("state", short_repr(state), _STATE) from error
        if not isinstance(state, RobotState):
            raise self._refusal("state", short_repr(state), _STATE)
        if not finite:
            components = [f"{name}'s {axis}" for name in _VECTORS for axis in "xz"]
            self._require_finite("state", numbers, (*_SCALARS, *components))
        return state

    def penetration(self) -> float:
        """Return the largest depth by which the robot overlaps the ground [m]."""
        depth = self._call("penetration")
        self._require_finite("penetration", (depth,), ("depth",))
        return float(depth)

    def ended(self) -> Outcome | None:
        """Return the outcome if the world has terminated by itself, else None."""
        if not self._terminates:
            return None
        outcome = self._call("ended")
        if outcome is not None and not isinstance(outcome, Outcome):
            raise self._refusal("ended", short_repr(outcome), "an Outcome, or None")
        return outcome

    def flipper_work(self) -> float | None:
        """Return the work of the flippers' motors since the start [J]; None: not measured."""
        if not self._is_powered:
            return None
        work = self._call("flipper_work")
        self._require_finite("flipper_work", (work,), ("work",))
        return float(work)

    def cast_rays(self, origin: FloatArray, directions: FloatArray, reach: float) -> FloatArray:
        """Return the distance from ``origin`` to the ground along each direction, (R,) [m].

        See ``flipperctl.api.RayWorld``.

        Raises:
            ConfigError: the engine casts no rays.
        """
        if not isinstance(self.unguarded, RayWorld):
            raise ConfigError(
                f"perception: the sensor casts rays, which sim={self._engine.plugin_name} cannot; "
                "choose an engine whose world is a flipperctl.api.RayWorld"
            )
        found = self._call("cast_rays", origin, directions, reach)
        allowed = f"distances ≥ 0 of the shape {(len(directions),)}"
        if not (isinstance(found, np.ndarray) and found.dtype.kind == "f"):
            raise self._refusal("cast_rays", short_repr(found), allowed)
        if found.shape != (len(directions),):
            raise self._refusal("cast_rays", f"an array of the shape {found.shape}", allowed)
        if not (found >= 0).all():  # false for NaN
            text = f"the distance {found[~(found >= 0)][0]:g}"
            raise self._refusal("cast_rays", text, allowed)
        return found

    def look(self, view: View, width: int, height: int) -> CameraImage:
        """Return what a camera of the robot shows; see ``flipperctl.api.CameraWorld``.

        Raises:
            ConfigError: the engine has no cameras.
        """
        if not isinstance(self.unguarded, CameraWorld):
            raise ConfigError(
                f"perception: the sensor has a camera, which sim={self._engine.plugin_name} "
                "lacks; choose an engine whose world is a flipperctl.api.CameraWorld"
            )
        image = self._call("look", view, width, height)
        shapes = (height, width, 3), (height, width)
        if not isinstance(image, CameraImage) or shapes != (image.pixels.shape, image.depth.shape):
            allowed = f"a CameraImage of {height} × {width} pixels"
            raise self._refusal("look", short_repr(image), allowed)
        return image

    def save(self) -> Any:
        """Return a snapshot of the changing state for ``load``."""
        return self._call("save")

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
        self._call("load", saved)

    def _call(self, method: str, *given: Any) -> Any:
        try:  # not ``naming``, since there are several calls in each decision
            return getattr(self.unguarded, method)(*given)
        except BaseException as error:  # noqa: BLE001  # raised again
            raise_named(error, self._engine, method)

    def _refusal(
        self,
        method: str,
        found: str,
        allowed: str,
        raised: type[FlipperctlError] = PluginFailedError,
    ) -> FlipperctlError:
        text, owner = f"returned {found}; allowed: {allowed}", type(self.unguarded)
        return refusal(self._engine, method, text, raised, owner=owner)

    def _require_finite(
        self, method: str, numbers: tuple[Any, ...] | list[Any], names: tuple[str, ...]
    ) -> None:
        for name, number in zip(names, numbers, strict=True):
            try:
                finite = math.isfinite(number)
            except (TypeError, ValueError, OverflowError) as error:
                found = f"{short_repr(number)} as {name}"
                raise self._refusal(method, found, "a number") from error
            if not finite:
                found, allowed = f"{number} as {name}", "a finite number"
                raise self._refusal(method, found, allowed, NonFiniteError)


class GuardedDrawingWorld(GuardedWorld):
    """A guarded ``flipperctl.api.DrawingWorld``."""

    def draw(self, width: int, height: int) -> NDArray[np.uint8]:
        """Return a picture of the current state, (H, W, 3)."""
        picture = self._call("draw", width, height)
        allowed = f"an array of uint8 of the shape {(height, width, 3)}"
        if not (isinstance(picture, np.ndarray) and picture.dtype == np.uint8):
            raise self._refusal("draw", short_repr(picture), allowed)
        if picture.shape != (height, width, 3):
            raise self._refusal("draw", f"an array of the shape {picture.shape}", allowed)
        return picture
