"""Which process works on a trial of a study that several searches may share, and whether it lives.

In: trials of Optuna. Out: their owner, in the trial's attributes. The owner writes the time into
them again and again, since another machine cannot see whether its process lives.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from threading import Event, Thread
from typing import TYPE_CHECKING

from flipperctl.runs.lock import holder, is_dead

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial, Trial

_OWNER, _SEEN = "owner", "seen"
_EVERY = 15.0
"""Time between two signs of life [s]."""
_GRACE = 120.0
"""Time after the last sign of life from which a process counts as dead [s]."""


def claim(trial: Trial) -> None:
    """Write into a trial that this process works on it."""
    trial.set_user_attr(_OWNER, holder())
    trial.set_user_attr(_SEEN, time.time())


@contextlib.contextmanager
def signs_of_life(trials: Sequence[Trial]) -> Iterator[None]:
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
    """Return whether a process that lives works on a trial that has not finished."""
    owner = trial.user_attrs.get(_OWNER)
    if owner is not None and is_dead(owner):
        return False
    begun = trial.datetime_start.timestamp() if trial.datetime_start else 0.0  # not claimed yet
    return time.time() - float(trial.user_attrs.get(_SEEN, begun)) < _GRACE
