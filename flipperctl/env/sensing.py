"""A sensor in use, guarded: every call into a plugin's sensing goes through here.

In: a sensor and the ground of one episode. Out: a ``flipperctl.api.GroundSensor`` whose failures
and wrong values are errors that name the sensor, the method, the file and the line.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flipperctl.api import Profile, RobotState, SensedAngles, SensedGround, Sensor
from flipperctl.errors import FlipperctlError, NonFiniteError, PluginFailedError
from flipperctl.guard import naming, refusal, short_repr

_NUMBERS = "fiu"
"""Kinds of numpy's types that are real numbers."""


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


class GuardedSensor:
    """A ``flipperctl.api.GroundSensor`` that calls what a sensor returned for one episode."""

    def __init__(self, sensor: Sensor, profile: Profile, margin: float) -> None:
        """Use ``sensor`` on ``profile`` with ``margin`` [m] of level ground on both sides.

        Raises:
            PluginFailedError: the sensor's code failed, or returned nothing that senses.
        """
        self._sensor, self._bins = sensor, sensor.layout.bins
        with naming(sensor, "over"):  # what it returned may fail as well
            self._in_use = sensor.over(profile, margin)
            senses = hasattr(self._in_use, "sense")
        if not senses:
            text = f"returned {short_repr(self._in_use)}; a flipperctl.api.GroundSensor is allowed"
            raise refusal(sensor, "over", text)

    def sense(
        self, state: RobotState, rng: np.random.Generator
    ) -> tuple[SensedGround, SensedAngles]:
        """Sense ground and posture from the robot's true state; noise is drawn from ``rng``.

        Raises:
            PluginFailedError: the sensor's code failed, or returned a value that is not allowed.
            NonFiniteError: a point, a height or an angle is not finite.
        """
        with naming(self._sensor, "sense"):
            ground, angles = self._in_use.sense(state, rng)
        self._check_ground(ground)
        self._check_angles(angles)
        return ground, angles

    def _check_ground(self, ground: object) -> None:
        if not isinstance(ground, SensedGround):
            raise self._refusal(short_repr(ground), "a SensedGround")
        points, heights, filled = ground.points, ground.heights, ground.filled
        if not (_is_array(points, _NUMBERS) and points.ndim == 2 and points.shape[1] == 2):
            raise self._refusal(f"points {_text(points)}", "numbers of the shape (P, 2)")
        if not (_is_array(heights, _NUMBERS) and heights.shape == (self._bins,)):
            raise self._refusal(
                f"heights {_text(heights)}", f"numbers of the shape {(self._bins,)}"
            )
        if filled is not None and not (_is_array(filled, "b") and filled.shape == (len(points),)):
            allowed = f"None, or booleans of the shape {(len(points),)}"
            raise self._refusal(f"filled {_text(filled)}", allowed)
        for name, numbers in (("points", points), ("heights", heights)):
            if not np.isfinite(numbers).all():
                raise self._refusal(f"{name} that are not finite", "finite numbers", NonFiniteError)

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
        self,
        found: str,
        allowed: str,
        raised: type[FlipperctlError] = PluginFailedError,
    ) -> FlipperctlError:
        text, owner = f"returned {found}; allowed: {allowed}", type(self._in_use)
        return refusal(self._sensor, "sense", text, raised, owner=owner)


def _is_array(value: Any, kinds: str) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind in kinds


def _text(value: Any) -> str:
    """Return what an array is, or the value itself if it is none."""
    if isinstance(value, np.ndarray):
        return f"of the type {value.dtype} and the shape {value.shape}"
    return short_repr(value)
