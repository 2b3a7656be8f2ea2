"""Notices draws from the global random generators of Python, numpy and torch.

All random numbers come from generators that are passed as arguments: what a global one gives
depends on all that was drawn before, in the whole process.
"""

from __future__ import annotations

import ctypes
import random
import sys

import numpy as np

_MT19937 = 2500  # bytes of numpy's struct: 624 words and the position


def global_states() -> dict[str, object]:
    """Return the states of the global generators by the names of their modules.

    torch's is left out in a process that has not imported torch. It takes about 10 µs.
    """
    states: dict[str, object] = {"random": random.getstate(), "numpy.random": _state_of_numpy()}
    if (torch := sys.modules.get("torch")) is not None:
        states["torch"] = torch.get_rng_state().numpy().tobytes()
    return states


def moved_since(before: dict[str, object]) -> str:
    """Return the names of the generators that were used since ``before``, "" if none was."""
    now = global_states()
    return " and ".join(name for name, state in before.items() if now[name] != state)


def _state_of_numpy() -> object:
    bits = np.random.get_bit_generator()  # type: ignore[attr-defined]  # not in the stubs
    if isinstance(bits, np.random.MT19937):  # its ``state`` copies word by word, which takes 40 µs
        return ctypes.string_at(bits.ctypes.state_address, _MT19937)
    return repr(bits.state)
