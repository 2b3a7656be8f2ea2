"""The trials of a study: finished, running, or abandoned by a process that died."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from flipperctl.runs.trial_owner import is_owned

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution
    from optuna.trial import FrozenTrial, Trial

FAILED: Final = "failed"
"""Marks a trial whose training failed; Optuna's FAIL also marks interrupted ones."""


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
