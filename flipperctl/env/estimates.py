"""Checks the ground and the posture that a sensor's code returned.

In: a returned value, and the sensor and method that returned it. Out: the ground and the angles,
or an error that names the sensor, the method, the file and the line.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flipperctl.api import SensedAngles, SensedGround, Sensor
from flipperctl.errors import FlipperctlError, NonFiniteError, PluginFailedError
from flipperctl.guard import naming, refusal, short_repr

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
        self._check_optional("sides", ground.sides, _NUMBERS, (2, *self._heights))
        if ground.deviation is not None and not (ground.deviation >= 0).all():  # nor NaN
            raise self._refusal("a deviation that is negative or NaN", "0 or more, or infinity")
        if ground.sides is not None and np.isinf(ground.sides).any():
            allowed = "finite numbers, or NaN where nothing was seen"
            raise self._refusal("sides that are infinite", allowed, NonFiniteError)
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
