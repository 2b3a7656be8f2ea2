"""``core.thinning.kept_points`` as machine code."""

from __future__ import annotations

from numba import njit

from flipperctl.core import thinning
from flipperctl.sim.jit import cached

kept_points = cached(njit)(thinning.kept_points)
