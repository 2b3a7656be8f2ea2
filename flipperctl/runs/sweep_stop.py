"""Stop every run of a sweep by one Ctrl-C, in any process in which a launcher trains it.

In: the sweep's folder. Out: in the sweeper's process, a context in which Ctrl-C and SIGTERM
create a marker file in the folder; in a job's process, a function that looks for the file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from flipperctl.results import is_dead
from flipperctl.runs.interrupts import interrupts

_MARK = ".sweep.stop"


@contextmanager
def stopping(folder: Path) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether the sweep in the locked ``folder`` must stop."""
    mark = folder / _MARK
    mark.unlink(missing_ok=True)  # of a sweep that was killed
    try:
        with interrupts("finishing the episodes and saving …", mark.touch):
            yield mark.exists
    finally:
        mark.unlink(missing_ok=True)


def stop_of(folder: Path, sweeper: dict[str, Any]) -> Callable[[], bool]:
    """Return a function, to call between episodes, that returns whether the job must stop.

    It must if the sweep was stopped, or if ``sweeper``, the process that waits for the job
    (``lock.holder``), has died.
    """
    mark = folder / _MARK
    return lambda: mark.exists() or is_dead(sweeper)
