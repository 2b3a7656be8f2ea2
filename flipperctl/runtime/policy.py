"""A policy from a file of ``flipperctl export onnx``.

In: the file; observations, or points of the ground with flipper angles and pitch, which make them
as in the simulator. Out: Q-values, actions and the risk, in about ten microseconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flipperctl.core import observation as layout
from flipperctl.core.observation import bin_heights
from flipperctl.core.risk import LAGS, EpisodeRisk, Escape, Place, RiskSign
from flipperctl.core.targets import Action, as_action, rates_of
from flipperctl.errors import FlipperctlError, NonFiniteError, PolicyError
from flipperctl.runtime.interface import (
    INPUT,
    LARGEST_ANGLE,
    RECURRENCE,
    RISK,
    interface_of,
    open_session,
    reason_of,
)

DEGREES = "angles are in radians"
Frame = Literal["L", "R"]
_LARGEST = float(np.finfo(np.float32).max)
_Number = TypeVar("_Number", np.float32, np.float64)
_ROUNDING = 1e-9
"""Distance past the last bin's edge that counts as rounding [m]."""


class _BoundRisk:
    """The risk of a session with bound outputs, which overwrites them at each decision."""

    def __init__(self, bound: Any, size: int, sign: RiskSign, stride: float) -> None:
        """``bound``: the session's binding of inputs and outputs; the others: ``EpisodeRisk``."""
        self._alone = np.zeros((1, 1), np.float32)
        self._coefficients = np.zeros((1, len(LAGS)), np.float32)
        for name, array in ((RISK, self._alone), (RECURRENCE, self._coefficients)):
            bound.bind_output(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)
        self._episode = EpisodeRisk(size, sign, stride)
        self.value: float | None = None
        """Risk at the last decision, 0 to 1; None before one."""

    def reset(self) -> None:
        """Begin an episode."""
        self._episode.reset()
        self.value = None

    def update(self, observation: NDArray[np.float32], place: Place | None, path: Path) -> None:
        """Compute the risk after a run of the session on ``observation``, (n,)."""
        alone, coefficients = self._alone.item(), self._coefficients[0]
        self.value = self._episode.update(alone, coefficients, observation, place)
        if math.isnan(self.value):
            raise NonFiniteError(
                f"{path}: the risk is not a finite number; the file is damaged, or the observation "
                "is far from those of the training"
            )


def _each(angle: Any) -> tuple[Any, ...]:
    """Return the angle of a pair, or the angles of its left and right flippers."""
    return tuple(angle) if isinstance(angle, Sequence | np.ndarray) else (angle,)


class OnnxPolicy:
    """An exported policy; use an object from one thread at a time.

    A policy whose input is several observations (``interface.frames``) stores the earlier ones:
    call ``reset`` at the start of each episode.

    Raises:
        MissingExtraError: onnxruntime is not installed.
        PolicyError: the file is missing, damaged, or not one that flipperctl exported.
        NonFiniteError: the network gives NaN or infinity for an observation of zeros.
    """

    def __init__(self, path: str | Path, *, escape: bool = True) -> None:
        """``escape``: whether a file with ``interface.escape`` draws actions while it warns.

        False: each action is that with the largest Q-value, and risk and warning stay.
        """
        self.path = Path(path)
        self._session = open_session(self.path)
        self.interface = interface_of(self._session, str(self.path))
        frame_size, size = self.interface.size, self.interface.inputs
        # The buffers are bound once: a decision then takes 10.5 µs inside onnxruntime, against
        # 12.9 µs with session.run and 46 µs with OrtValues (an at_d3qn policy, one core).
        self._input = np.zeros((1, size), np.float32)
        self._output = np.zeros((1, len(self.interface.actions)), np.float32)
        self._frames = self._input.reshape(self.interface.frames, -1)
        self._row, self._q = self._frames[-1], self._output[0]
        self._older, self._newer = self._input[0, :-frame_size], self._input[0, frame_size:]
        self._has_history, self._episode_begins = len(self._frames) > 1, True
        self._limits = self.interface.limits.astype(np.float32)
        self._input_limits = np.tile(self._limits, self.interface.frames)
        self._bound = self._session.io_binding()
        pointers = self._input.ctypes.data, self._output.ctypes.data
        self._bound.bind_input(INPUT, "cpu", 0, np.float32, (1, size), pointers[0])
        shape = self._output.shape
        self._bound.bind_output(self.interface.output, "cpu", 0, np.float32, shape, pointers[1])
        self._rates = self.interface.kind == "rates"
        # What some files have besides: a risk, and actions that are drawn
        sign, speed = self.interface.risk, float(self.interface.robot.get("track_speed", 0.0))
        stride = speed * self.interface.decision_period
        self._risk = None if sign is None else _BoundRisk(self._bound, frame_size, sign, stride)
        rule = self.interface.escape
        self._escape = Escape(rule) if rule is not None and escape else None
        self.act(np.zeros(frame_size))  # the first run allocates
        self.reset()

    def reset(self) -> None:
        """Begin an episode: the next observation also fills the frames before it."""
        self._episode_begins = True
        if self._risk is not None:
            self._risk.reset()
        if self._escape is not None:
            self._escape.reset()

    @property
    def risk(self) -> float | None:
        """Probability at the last decision that the episode fails soon, 0 to 1.

        ``interface.risk`` has the number of these decisions. None before the first decision after
        ``reset``, and for a file without a risk.
        """
        return None if self._risk is None else self._risk.value

    @property
    def warning(self) -> bool:
        """Whether the risk is the file's threshold or more; False without a risk."""
        sign = self.interface.risk
        return sign is not None and sign.warns(self.risk)

    def observation(
        self,
        points: ArrayLike,
        *,
        front: float | Sequence[float],
        rear: float | Sequence[float],
        pitch: float,
        frame: Frame = "L",
        sides: tuple[ArrayLike, ArrayLike] | None = None,
        roll: float = 0.0,
    ) -> NDArray[np.float32]:
        """Return the observation for ``act`` from the robot's measurements, (n,) in SI units.

        It is computed as in the simulator. ``points``: ground below and around the robot in its
        side plane, (P, 2) of x (forward) and z (up) [m] from the chassis centre, in any order.
        Points beyond the bins are ignored. ``frame`` of the points: ``L`` is level, ``R`` is fixed
        to the chassis. ``front``, ``rear``: angles of the flippers in frame R, above the chassis
        positive, each of a pair, or of the left and the right one where each of four turns alone
        [rad]; ``pitch``: nose up positive [rad].
        A policy with sides takes the same points below the left and below the right tracks as
        ``sides``, by default ``points`` for both, and the ``roll``, left side up positive [rad].

        Raises:
            PolicyError: the points have another shape, are not numbers, or none lies in a bin.
            NonFiniteError: a point or an angle is NaN or infinite.
        """
        # Frame and angles are refused by what is wrong with each, then the points.
        if frame not in ("L", "R"):
            raise PolicyError(
                f"{self.path}: there is no frame {frame!r}; 'L' (level) or 'R' is allowed"
            )
        flippers = [*_each(front), *_each(rear)]
        if len(flippers) != len(self.interface.joints):
            raise PolicyError(
                f"{self.path}: there are {len(flippers)} angles of flippers; those of "
                f"{', '.join(self.interface.joints)} are allowed"
            )
        named = [*zip(self.interface.joints, flippers, strict=True), ("pitch", pitch)]
        for name, angle in [*named, ("roll", roll)]:
            try:
                finite = -_LARGEST <= angle <= _LARGEST
            except (TypeError, ValueError) as error:
                text = f"{self.path}: {name} is {str(angle)[:40]}; a number is allowed"
                raise PolicyError(text) from error
            if not finite:
                raise NonFiniteError(f"{self.path}: {name} is {angle}; finite numbers are allowed")

        # The heights of the bins, as in the simulator
        pitched = pitch if frame == "R" else 0.0
        heights, with_sides = self._heights(points, pitched), self.interface.sides
        if with_sides and sides is not None:
            both = (self._heights(side, pitched) for side in sides)
            heights = np.concatenate([heights, *both])
        heights = np.resize(heights, self.interface.heights)
        tilted = roll if with_sides else None
        return layout.assemble(heights, flippers, pitch=pitch, roll=tilted)

    def _heights(self, points: ArrayLike, pitch: float) -> NDArray[np.float64]:
        """Return the heights of the bins by points (P, 2), which are pitched by so much [rad]."""
        ground = self._real(points, np.float64, "points are")
        if ground.ndim != 2 or ground.shape[1] != 2:
            shape = f"the points have shape {ground.shape}"
            raise PolicyError(f"{self.path}: {shape}; (P, 2) is allowed")
        bad = np.flatnonzero(~np.isfinite(ground).all(axis=1))
        if bad.size:
            raise NonFiniteError(
                f"{self.path}: point {bad[0]} is {tuple(ground[bad[0]].tolist())}; finite numbers "
                "are allowed: leave out what the sensor did not measure"
            )
        if pitch:
            ground = layout.to_level(ground, pitch)
        bins, bin_width = self.interface.bins, self.interface.bin_width
        reach = layout.reach(bins, bin_width)
        near = ground[np.abs(ground[:, 0]) <= reach + _ROUNDING]
        if not len(near):
            raise PolicyError(
                f"{self.path}: none of the {len(ground)} points lies within ±{reach:g} m of the "
                "chassis centre"
            )
        return bin_heights(near, bins, bin_width, highest=self.interface.highest)

    def act(self, observation: ArrayLike, position: ArrayLike | None = None) -> Action:
        """Return the index of an action, a row of ``interface.actions``, or rates.

        An index means the largest Q-value, unless ``interface.escape`` has it drawn. Rates are of
        all joints, each from -1 to 1. Call it only while the belts drive
        ahead, as in training: a parked robot looks like a stuck one. After a stop, call ``reset``
        first.

        ``observation``: (n,) in SI units, in the order of ``interface.observation``.
        ``position``: x and z, or x, y and z, of the chassis centre by odometry that does not take
        slipping belts for motion, (2,) or (3,) [m]. It has an origin of its own. With it, a policy
        with a risk also warns while the robot stands.

        Raises:
            PolicyError: the observation or the position has another shape, is not numeric, or
                exceeds ``interface.limits``.
            NonFiniteError: the observation, the position or a Q-value is NaN or infinite.
        """
        # The newest observation behind the earlier ones
        place = None if position is None else self._place(position)
        array = self._numbers(observation, self.interface.size)
        if array.shape != self._row.shape:
            raise self._shape_error(array, f"({self.interface.size},)")
        # False for NaN too; counting takes half a microsecond less than all().
        if np.count_nonzero(np.abs(array) <= self._limits) < array.size:
            raise self._value_error(array)
        if self._episode_begins:
            self._frames[:-1] = array
            self._episode_begins = False
        elif self._has_history:
            self._older[:] = self._newer
        self._row[...] = array
        try:
            self._session.run_with_iobinding(self._bound)
        except Exception as error:  # onnxruntime's errors share no base class
            raise self._run_error(error) from error

        # The action of the largest Q-value, rates, or one that is drawn
        action: Action = int(self._q.argmax())
        if not math.isfinite(self._q.item(action)):  # argmax returns a NaN before any number
            raise self._non_finite_error(self._output)
        if self._risk is not None:
            self._risk.update(self._row, place, self.path)
        if self._rates:
            return rates_of(self._q.tolist())
        if self._escape is not None and self._escape.due(warns=self.warning):
            return self._escape.draw(self._q.tolist())
        return action

    def next_targets(
        self, targets: ArrayLike, angles: ArrayLike, action: Action
    ) -> NDArray[np.float64]:
        """Return the angles to which an action turns the joints, (J,) [rad].

        ``targets``: the last targets, or the measured angles at the start of an episode;
        ``angles``: the measured angles. Both are in the order of ``interface.joints`` in frame R,
        (J,) [rad]. The rule is ``interface.targets``, as in the environment.

        Raises:
            PolicyError: an argument is not J numbers within ±π, or there is no such action.
            NonFiniteError: an angle is NaN or infinite.
        """
        joints = len(self.interface.joints)
        parsed = as_action(action, joints)
        if parsed is None or isinstance(parsed, tuple) is not self._rates:
            allowed = (
                f"{joints} rates from -1 to 1 are"
                if self._rates
                else f"a whole number from 0 to {3**joints - 1} is"
            )
            raise PolicyError(
                f"{self.path}: there is no action {str(action)[:40]}; {allowed} allowed"
            )
        last, measured = self._angles("targets", targets), self._angles("angles", angles)
        table = self.interface.actions
        turns = (table[parsed] if isinstance(parsed, int) else np.array(parsed) @ table).tolist()
        return np.array(self.interface.targets.next_targets(last, measured, turns))

    def _place(self, position: ArrayLike) -> Place:
        place = self._real(position, np.float64, "coordinates are")
        if place.shape not in ((2,), (3,)):
            shape = f"the position has shape {place.shape}"
            raise PolicyError(f"{self.path}: {shape}; (2,) and (3,) are allowed")
        if not np.isfinite(place).all():
            text = f"{self.path}: the position is {place}; finite numbers are allowed"
            raise NonFiniteError(text)
        coordinates: Place = place.tolist()
        return coordinates

    def _angles(self, name: str, values: ArrayLike) -> list[float]:
        angles = self._real(values, np.float64, f"{name} are")
        if angles.shape != (shape := (len(self.interface.joints),)):
            text = f"{self.path}: the {name} have shape {angles.shape}; {shape} is allowed"
            raise PolicyError(text)
        if not np.isfinite(angles).all():
            text = f"{self.path}: the {name} are {angles}; finite numbers are allowed"
            raise NonFiniteError(text)
        if not (np.abs(angles) <= LARGEST_ANGLE).all():
            raise PolicyError(f"{self.path}: the {name} are {angles} rad; ±π is allowed: {DEGREES}")
        numbers: list[float] = angles.tolist()
        return numbers

    def q_values(self, observation: ArrayLike) -> NDArray[np.float32]:
        """Return the Q-values (3^J,) of one input (frames · n,), or (B, 3^J) of a batch of B.

        A file with rates returns these, (J,) or (B, J).

        An input is ``interface.frames`` observations, oldest first; the observations stored by
        ``act`` are neither read nor changed.

        Raises:
            PolicyError: the observation has another shape, is not numeric, or exceeds
                ``interface.limits``.
            NonFiniteError: the observation or a Q-value is NaN or infinite.
        """
        size = self.interface.inputs
        array = self._numbers(observation, size)
        if array.ndim not in (1, 2) or array.shape[-1] != size:
            raise self._shape_error(array, f"({size},) or (B, {size})")
        if not (np.abs(array) <= self._input_limits).all():
            raise self._value_error(array)
        batch = np.ascontiguousarray(array.reshape(-1, size))
        values: NDArray[np.float32]
        try:
            values = self._session.run([self.interface.output], {INPUT: batch})[0]
        except Exception as error:  # onnxruntime's errors share no base class
            raise self._run_error(error) from error
        if not np.isfinite(values).all():
            raise self._non_finite_error(values)
        return values[0] if array.ndim == 1 else values

    def _numbers(self, observation: ArrayLike, size: int) -> NDArray[np.float32]:
        if observation is None:  # numpy would read it as NaN
            raise PolicyError(
                f"{self.path}: there is no observation (None); {size} numbers are needed"
            )
        return self._real(observation, np.float32, "observation is")

    def _real(self, values: ArrayLike, dtype: type[_Number], what: str) -> NDArray[_Number]:
        """Return an array of real numbers; text and complex numbers are none."""
        try:
            array = np.asarray(values)
            if array.dtype.kind in "cSU":
                raise TypeError(f"their type is {array.dtype}")
            return array.astype(dtype, copy=False)
        except (TypeError, ValueError, OverflowError) as error:
            raise PolicyError(f"{self.path}: the {what} not numbers: {error}") from error

    def _run_error(self, error: Exception) -> PolicyError:
        return PolicyError(f"{self.path}: onnxruntime cannot run the model: {reason_of(error)}")

    def _value_error(self, array: NDArray[np.float32]) -> FlipperctlError:
        """Return an error that names the first number that is not finite or exceeds its limit."""
        size = self.interface.size
        limits = np.resize(self._limits, array.shape)
        index = np.argwhere(~(np.abs(array) <= limits))[0]
        at, quantity = index[-1] % size, self.interface.observation[index[-1] % size]
        value, limit = float(array[tuple(index)]), self.interface.limits[at]
        problem = f"{self.path}: observation{index.tolist()} ({quantity.name}) is {value:g}"
        if not math.isfinite(value):
            return NonFiniteError(f"{problem}; finite numbers are allowed")
        if at >= self.interface.heights:
            return PolicyError(f"{problem} rad; ±π is allowed: {DEGREES}")
        return PolicyError(
            f"{problem} m; ±{limit:g} m is allowed: heights are in metres, measured from the "
            "chassis centre"
        )

    def _shape_error(self, array: NDArray[np.float32], allowed: str) -> PolicyError:
        return PolicyError(
            f"{self.path}: the observation has shape {array.shape}; {allowed} is allowed: "
            f"{self.interface.heights} terrain heights and "
            f"{self.interface.size - self.interface.heights} angles"
            f"{', of each frame' if self._has_history else ''}"
        )

    def _non_finite_error(self, values: NDArray[np.float32]) -> NonFiniteError:
        row, action = np.argwhere(~np.isfinite(values))[0]
        return NonFiniteError(
            f"{self.path}: the Q-value of action {action} is {values[row, action]}; "
            "the file is damaged, or the observation is far from those of the training"
        )
