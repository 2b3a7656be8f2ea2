"""The directions in which a LiDAR of 32 rings measures.

In: the number of azimuths. Out: unit vectors in frame S, whose z axis is the axis of the rings.
"""

from __future__ import annotations

import numpy as np

from flipperctl.api import FloatArray

RINGS = 32
"""Number of lasers, each of which draws a ring [-]."""
_LOWEST, _SPACING = np.radians(2.3125), np.radians(2.8125)
"""Angle of the lowest ring above the base, and between two rings [rad].

By the table of channels in the RS-Bpearl's user manual (2.0.1), from 2.3125° to 89.5°.
"""


def directions(azimuths: int) -> FloatArray:
    """Return a ray for each of ``azimuths`` and ``RINGS``, (R, 3)."""
    above = _LOWEST + _SPACING * np.arange(RINGS)
    around = 2 * np.pi / azimuths * np.arange(azimuths)
    height, azimuth = (angles.ravel() for angles in np.meshgrid(above, around))
    flat = np.cos(height)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(height)])
