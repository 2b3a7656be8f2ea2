"""Which process works on a trial of a shared study, and whether that process is alive.

In: trials of Optuna. Out: their owner, in the trial's attributes. The owner updates a time in them
regularly, since another machine cannot see whether its process is alive.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from threading import Event, Thread
from typing import TYPE_CHECKING

from flipperctl.results import holder, is_dead

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial, Trial

_OWNER, _SEEN = "owner", "seen"
_EVERY = 15.0
"""Time between two heartbeats [s]."""
_GRACE = 120.0
"""Time after the last heartbeat at which a process counts as dead [s]."""


def claim(trial: Trial) -> None:
    """Mark a trial as one on which this process works."""
    trial.set_user_attr(_OWNER, holder())
    trial.set_user_attr(_SEEN, time.time())


@contextlib.contextmanager
def heartbeat(trials: Sequence[Trial]) -> Iterator[None]:
    """Write the time into the trials every 15 s, until the context ends."""
    from optuna.exceptions import OptunaError

    ended = Event()

    def write() -> None:
        while not ended.wait(_EVERY):
            for trial in trials:
                with contextlib.suppress(OptunaError, RuntimeError):  # the next one may succeed
                    trial.set_user_attr(_SEEN, time.time())

    thread = Thread(target=write, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def is_owned(trial: FrozenTrial) -> bool:
    """Return whether a live process works on an unfinished trial."""
    owner = trial.user_attrs.get(_OWNER)
    if owner is not None and is_dead(owner):
        return False
    begun = trial.datetime_start.timestamp() if trial.datetime_start else 0.0  # not claimed yet
    return time.time() - float(trial.user_attrs.get(_SEEN, begun)) < _GRACE
