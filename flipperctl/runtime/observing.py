"""The observation of a policy from a robot's measurements.

In: points of the ground, flipper angles and the pitch. Out: an observation, computed as in the
simulator.
"""

from __future__ import annotations

from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flipperctl.core import observation as layout
from flipperctl.core.observation import mean_heights
from flipperctl.errors import NonFiniteError, PolicyError
from flipperctl.runtime.interface import Interface

Frame = Literal["L", "R"]
_LARGEST = float(np.finfo(np.float32).max)
Number = TypeVar("Number", np.float32, np.float64)
_ROUNDING = 1e-9
"""Distance past the last bin's edge that counts as rounding [m]."""


def observe(
    interface: Interface,
    points: ArrayLike,
    *,
    front: float,
    rear: float,
    pitch: float,
    frame: Frame,
    where: str,
) -> NDArray[np.float32]:
    """Return an observation, (N + 3,); see ``OnnxPolicy.observation``. ``where``: for errors."""
    ground = _points(points, where)
    if frame not in ("L", "R"):
        raise PolicyError(f"{where}: there is no frame {frame!r}; 'L' (level) or 'R' is allowed")
    for name, angle in (("front", front), ("rear", rear), ("pitch", pitch)):
        try:
            finite = -_LARGEST <= angle <= _LARGEST
        except (TypeError, ValueError) as error:
            text = f"{where}: {name} is {str(angle)[:40]}; a number is allowed"
            raise PolicyError(text) from error
        if not finite:
            raise NonFiniteError(f"{where}: {name} is {angle}; finite numbers are allowed")
    if frame == "R":
        ground = layout.to_level(ground, pitch)
    reach = layout.reach(interface.bins, interface.bin_width)
    near = ground[np.abs(ground[:, 0]) <= reach + _ROUNDING]
    if not len(near):
        raise PolicyError(
            f"{where}: none of the {len(ground)} points lies within ±{reach:g} m of the chassis "
            "centre"
        )
    heights = mean_heights(near, interface.bins, interface.bin_width)
    return layout.assemble(heights, front=front, rear=rear, pitch=pitch)


def real_numbers(values: ArrayLike, dtype: type[Number]) -> NDArray[Number]:
    """Return an array of real numbers.

    Raises:
        TypeError: the values are text or complex numbers, which numpy would convert.
        ValueError, OverflowError: they are no numbers, or too large.
    """
    found = np.asarray(values)
    if found.dtype.kind in "cSU":
        raise TypeError(f"their type is {found.dtype}")
    return found.astype(dtype, copy=False)


def _points(points: ArrayLike, where: str) -> NDArray[np.float64]:
    try:
        ground = real_numbers(points, np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise PolicyError(f"{where}: the points are not numbers: {error}") from error
    if ground.ndim != 2 or ground.shape[1] != 2:
        raise PolicyError(f"{where}: the points have shape {ground.shape}; (P, 2) is allowed")
    bad = np.flatnonzero(~np.isfinite(ground).all(axis=1))
    if bad.size:
        raise NonFiniteError(
            f"{where}: point {bad[0]} is {tuple(ground[bad[0]].tolist())}; finite numbers are "
            "allowed: leave out what the sensor did not measure"
        )
    return ground
