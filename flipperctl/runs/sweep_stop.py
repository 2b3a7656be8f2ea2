"""One Ctrl-C stops every run of a sweep, in whichever process a launcher trains it.

In: the sweep's folder. Out: in the process of the sweeper, a context in which Ctrl-C and SIGTERM
leave a mark in the folder; in that of a job, a function that looks for the mark.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from flipperctl.runs.interrupts import interrupts
from flipperctl.runs.lock import is_dead

_MARK = ".sweep.stop"


@contextmanager
def stopping(folder: Path) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether the sweep in ``folder``, which is held, shall stop."""
    mark = folder / _MARK
    mark.unlink(missing_ok=True)  # of a sweep that was killed
    try:
        with interrupts("finishing the episodes and saving …", mark.touch):
            yield mark.exists
    finally:
        mark.unlink(missing_ok=True)


def stop_of(folder: Path, sweeper: dict[str, Any]) -> Callable[[], bool]:
    """Return whether the job of this process shall stop, as a function to call between episodes.

    It shall if the sweep was stopped, or if ``sweeper``, the process that waits for the job (of
    ``lock.holder``), has died.
    """
    mark = folder / _MARK
    return lambda: mark.exists() or is_dead(sweeper)
