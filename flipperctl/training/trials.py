"""The trials of a study: finished, running, or abandoned by a process that died, and their runs.

In: trials of Optuna. Out: their owner, in the attributes of a trial, whose time it updates
regularly, since another machine cannot see whether its process is alive; and the run of a trial.
"""

from __future__ import annotations

import contextlib
import itertools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, Final

from flipperctl.checkpoint import job_order
from flipperctl.results import SUMMARY, holder, is_dead
from flipperctl.training.sweep import SweepRun, sweep_run

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution
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


FAILED: Final = "failed"
"""Marks a trial whose training failed; Optuna's FAIL also marks interrupted ones."""

RUN: Final = "run"
"""Path of the run of a trained trial."""

PLACE: Final = "place"
"""Place of a trial in the search, which decides what is sampled [-]."""


def finished(study: Study) -> list[FrozenTrial]:
    """Return the trials that count: trained to the end, or with a training that failed."""
    return [trial for trial in study.get_trials(deepcopy=False) if _counts(trial)]


def running(study: Study) -> list[FrozenTrial]:
    """Return the trials on which a process works."""
    return [trial for trial in study.get_trials(deepcopy=False) if _runs(trial)]


def begun(study: Study) -> list[FrozenTrial]:
    """Return the trials that count or run, all as of one instant.

    Between two readings a trial may finish, which would then be in neither or in both.
    """
    trials = study.get_trials(deepcopy=False)
    return [trial for trial in trials if _counts(trial) or _runs(trial)]


def counted_twin(study: Study, trial: Trial) -> FrozenTrial | None:
    """Return an earlier trial with the values of this one that counts; its training is the same."""
    return next((other for other in _twins(study, trial) if _counts(other)), None)


def run_number(study: Study, trial: Trial) -> int:
    """Return the number of a trial's run: that of a stopped trial with its values, to go on."""
    return min([trial.number, *(other.number for other in _twins(study, trial))])


def _twins(study: Study, trial: Trial) -> list[FrozenTrial]:
    """Return the closed trials with the values of this one."""
    trials = study.get_trials(deepcopy=False)
    return [one for one in trials if one.state.is_finished() and one.params == trial.params]


def free_place(study: Study, trial: Trial) -> int:
    """Return the lowest place that no earlier trial has which counts or runs.

    A trial that has just begun has not noted its own; it counts as the lowest free one.
    """
    taken: set[int] = set()
    for other in begun(study):  # in the order of their numbers
        if other.number < trial.number:
            taken.add(other.user_attrs.get(PLACE, _lowest_free(taken)))
    return _lowest_free(taken)


def _lowest_free(taken: set[int]) -> int:
    return next(place for place in itertools.count() if place not in taken)


def _counts(trial: FrozenTrial) -> bool:
    return trial.value is not None or FAILED in trial.user_attrs


def _runs(trial: FrozenTrial) -> bool:
    return not trial.state.is_finished() and is_owned(trial)


def fail_abandoned(study: Study) -> None:
    """Close the trials of processes that died."""
    for trial in study.get_trials(deepcopy=False):
        if not trial.state.is_finished() and not is_owned(trial):
            stop(study, trial.number)


def suggest(trial: Trial, name: str, distribution: BaseDistribution) -> None:
    """Let the study's sampler choose the trial's value of a parameter."""
    found: Any = distribution
    if hasattr(found, "choices"):
        trial.suggest_categorical(name, found.choices)
    else:
        whole = isinstance(found.low, int)
        choose: Any = trial.suggest_int if whole else trial.suggest_float
        choose(name, found.low, found.high, log=found.log)


def stop(study: Study, number: int) -> None:
    """Close a trial that was killed or interrupted; it does not count and is sampled again."""
    from optuna.trial import TrialState

    study.tell(number, state=TrialState.FAIL, skip_if_finished=True)


def run_of(trial: FrozenTrial, folder: Path) -> Path:
    """Return the run of a trained trial, below ``folder`` if that was moved."""
    run = Path(trial.user_attrs[RUN])
    moved = folder.absolute() / run.name
    return moved if not run.exists() and moved.exists() else run


def finished_runs(study: Study, folder: Path) -> Iterator[SweepRun]:
    """Yield each run of finished trials below ``folder``; other searches have theirs elsewhere."""
    trials = {  # trials with equal values share a run; others failed and have none
        run_of(trial, folder): trial for trial in finished(study) if RUN in trial.user_attrs
    }
    for run, trial in trials.items():
        if run.is_relative_to(folder.absolute()) and (run / SUMMARY).is_file():
            number, _ = job_order(run)
            values = {name.lstrip("+~"): str(value) for name, value in trial.params.items()}
            yield sweep_run(number, values, run, None)
