"""The trials of a study: finished, running, or abandoned by a process that died."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any, Final

from flipperctl.runs.trial_owner import is_owned

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution
    from optuna.trial import FrozenTrial, Trial

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

    Trials of earlier versions do not know theirs; it is their number among the others.
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
