"""Measurements and the estimates made from them, in simulation and on a robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import FloatArray


@dataclass(frozen=True)
class SensedGround:
    """The sensed ground around the robot, in frame L."""

    points: FloatArray
    """(P, 2) sensed and ``filled`` points, x never decreasing [m]."""
    heights: FloatArray | None = None
    """(N,) mean height of each bin (paper Eq. 1), or (2 N,) with the highest ones, as the layout
    says [m]; with sides, those of the left and of the right follow. None: they follow from
    ``points``, and both sides are equal."""
    filled: NDArray[np.bool_] | None = None
    """(P,) whether a point fills unseen ground; None: every point was seen."""
    seen: NDArray[np.bool_] | None = None
    """(N,) whether any ground of a bin was ever seen; None: all of it."""
    position: FloatArray | None = None
    """(2,) x and z of the chassis centre by the sensor's odometry, from an origin of its own [m];
    None: it has none."""
    deviation: FloatArray | None = None
    """(N,) standard deviation of each height's error, as the estimator judges it, infinite where
    nothing was seen [m]; None: it is not judged."""


@dataclass(frozen=True)
class SensedAngles:
    """The sensed posture of the robot."""

    front: float
    """Angle of the front flippers in frame R [rad]."""
    rear: float
    """Angle of the rear flippers in frame R [rad]."""
    pitch: float
    """Pitch of the chassis, nose up positive [rad]."""
    roll: float = 0.0
    """Roll of the chassis, left side up positive; 0 where it is not sensed [rad]."""
    flippers: tuple[float, ...] = ()
    """Angles of four flippers, front left, front right, rear left, rear right, of which ``front``
    and ``rear`` are means; empty: of pairs [rad]."""


@dataclass(frozen=True)
class Measured:
    """A measurement with its instrument and time."""

    instrument: str
    """Name of the instrument."""
    time: float
    """Time since the start of the episode [s]."""
    value: object
    """What the instrument returned, a frozen dataclass of numbers and arrays."""


class Estimator(Protocol):
    """Estimates ground and posture from measurements alone.

    It runs in simulation and on a robot, so its code must need only Python, numpy and
    ``flipperctl.core``. It may keep state.
    """

    def update(self, measured: Measured) -> None:
        """Receive a measurement; each instrument's measurements arrive in order of time."""

    def estimate(self, time: float) -> tuple[SensedGround, SensedAngles]:
        """Return the estimate for ``time`` [s], which is not before the last measurement."""

    def save(self) -> Any:
        """Return a snapshot of the state, which later updates do not change."""

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
