"""Figures of terrains, learning curves and episodes. Imports matplotlib.

All drawing happens within ``settings``: equal input gives equal files, whatever the user's own
settings of matplotlib are. Agg draws everything; a user's backend, valid or not, stays the user's.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any

# A backend that matplotlib does not know would stop its import, though nothing here uses it.
if "matplotlib" not in sys.modules:
    _backend = os.environ.pop("MPLBACKEND", None)  # matplotlib refuses unknown names at its import
    import matplotlib

    if _backend is not None:
        os.environ["MPLBACKEND"] = _backend
        with contextlib.suppress(ValueError):
            matplotlib.rcParams["backend"] = _backend
else:
    import matplotlib


@contextlib.contextmanager
def settings(**overrides: Any) -> Iterator[None]:
    """Draw and save with matplotlib's own defaults and ``overrides``, then restore the user's."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        values: Any = matplotlib.rcParams  # whose stubs list every name
        values.update(overrides)
        yield
