"""``core.bins.sum_heights`` as machine code."""

from __future__ import annotations

from numba import njit

from flipperctl.core import bins
from flipperctl.sim.jit import cached

sum_heights = cached(njit)(bins.sum_heights)
"""``core.bins.sum_heights``, compiled."""
