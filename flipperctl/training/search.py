"""A search over trainings that resumes after any stop: Optuna proposes, the caller trains.

In: a study, new or as earlier searches left it, what it samples, and the sweep that trains its
jobs. Out: one training for each trial, the results in the study, ``optimization_results.yaml`` in
the folder of the sweep.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from omegaconf import OmegaConf

from flipperctl.errors import (
    ConfigError,
    FlipperctlError,
    InterruptedRunError,
    NonFiniteError,
    PluginFailedError,
    RequestError,
)
from flipperctl.session import command, sweep_command
from flipperctl.training.search_space import Interval, SearchSettings, distributions
from flipperctl.training.sweep import JobResult, Sweep

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution
    from optuna.trial import Trial
from flipperctl.training.trials import (
    FAILED,
    PLACE,
    RUN,
    claim,
    counted_twin,
    fail_abandoned,
    finished,
    finished_runs,
    free_place,
    heartbeat,
    run_number,
    run_of,
    running,
    stop,
    suggest,
)

_PAUSE = 1.0
"""Time to wait for another search that is creating the tables of the storage [s]."""
_MEASURE, _AT_100_HZ = "measure", "pitch_variation_100hz"
"""Attribute of a study that names the θ̂_R in its objective; earlier versions wrote none."""


def open_study(settings: SearchSettings, arguments: Sequence[str]) -> Study:
    """Return the study of ``settings``, new or as earlier searches left it.

    Raises:
        ConfigError: the storage cannot be used, or the study has other overrides than
            ``arguments`` or another objective.
    """
    import optuna
    from sqlalchemy.exc import SQLAlchemyError

    name, storage = settings.study_name, settings.storage
    create = partial(
        optuna.create_study,
        storage=storage,
        study_name=name,
        direction="maximize",
        load_if_exists=True,
    )
    with usable(storage, ImportError, ValueError):  # of its driver and of its URL
        try:
            study = create()
        except SQLAlchemyError:  # another search may be creating the tables
            time.sleep(_PAUSE)
            study = create()
    with usable(storage):
        _take_up(study, settings, sorted(arguments))
    return study


@contextlib.contextmanager
def usable(storage: str | None, *more: type[Exception]) -> Iterator[None]:
    """Turn errors of a study's storage, and ``more``, into a ConfigError that names it."""
    from optuna.exceptions import StorageInternalError
    from sqlalchemy.exc import SQLAlchemyError

    errors: tuple[type[Exception], ...] = (StorageInternalError, SQLAlchemyError, *more)
    try:
        yield
    except errors as error:
        cause = error.__cause__ if isinstance(error, StorageInternalError) else None
        reason = " ".join(str(cause or error).split("\n(Background")[0].split())
        raise ConfigError(
            f"hydra.sweeper.storage: {storage!r} cannot be used: {reason}; "
            "a database URL is allowed, as in sqlite:///search.db"
        ) from error


def _take_up(study: Study, settings: SearchSettings, asked: list[str]) -> None:
    """Check that a study searched the same, and note what it searches.

    Raises:
        ConfigError: see ``open_study``.
    """
    name, storage = settings.study_name, settings.storage
    searched = study.user_attrs.get("overrides", asked)
    if searched != asked:
        raise ConfigError(
            f"hydra.sweeper.study_name: the study {name!r} in {storage} searched "
            f"{' '.join(searched)}; give the same overrides, or another study_name"
        )
    if study.user_attrs.get(_MEASURE) != _AT_100_HZ and finished(study):
        raise ConfigError(
            f"hydra.sweeper.study_name: the trials of the study {name!r} in {storage} are "
            "ordered by θ̂_R at decisions, as in earlier versions, and cannot be compared with "
            "new ones, which are ordered by θ̂_R at 100 Hz; give another study_name"
        )
    study.set_user_attr("overrides", asked)
    study.set_user_attr(_MEASURE, _AT_100_HZ)


_POLL = 1.0
"""Time between two polls of the trials of other searches [s]."""


def search(
    settings: SearchSettings,
    jobs: Sweep,
    overrides: Sequence[str],
    sampled: Mapping[str, Interval | Sequence[str]],
    fixed: Sequence[str],
    *,
    tell: Callable[[str], None],
) -> None:
    """Train trial after trial, and write the best.

    ``sampled`` are the intervals and lists among the ``overrides``, by their keys; ``fixed`` are
    the others, which every job has. ``tell`` is called with lines about the progress.

    Raises:
        ConfigError: the storage cannot be used, the study searched something else, or there is
            nothing to search.
        InterruptedRunError: the search was stopped.
        RunHeldError: another process works in the sweep's folder.
        FlipperctlError: a trial was refused, or every trial failed.
    """
    space = distributions(sampled)
    study = open_study(settings, overrides)
    jobs.swept = list(space)
    found = OptunaSearch(settings, study, jobs, space, fixed, tell)
    with usable(settings.storage):
        with jobs.held():
            found.run()
        found.conclude()


@dataclass(frozen=True)
class OptunaSearch:
    """A search that asks Optuna for trials until ``n_trials`` are finished.

    The proposals of one search depend only on the seed and the finished trials, so a resumed search
    whose trials are trained one by one has the same results as an uninterrupted one. Several
    searches may share a study, each in a folder of its own.
    """

    settings: SearchSettings
    study: Study
    jobs: Sweep
    space: Mapping[str, BaseDistribution]
    """What is sampled, by key."""
    fixed: Sequence[str]
    """Overrides of every job."""
    tell: Callable[[str], None]
    """Called with a line about the progress of the search."""

    def run(self) -> None:
        """Train trial after trial.

        Raises:
            InterruptedRunError: the search was stopped; the text has the command to go on with.
            RequestError: a trial was refused.
        """
        study = self.study
        if known := len(finished(study)):
            self.tell(f"the study {study.study_name!r} has {known} finished trials already")
            self.jobs.take_up(finished_runs(study, self.jobs.folder))
        awaited = 0
        while (count := len(finished(study))) < self.settings.n_trials:
            fail_abandoned(study)
            others = len(running(study))
            size = min(self.settings.n_jobs, self.settings.n_trials - count - others)
            if size <= 0:
                if others != awaited:
                    self.tell(f"waiting for trials of another search: {others}")
                awaited = others
                self._raise_if_stopped()
                time.sleep(_POLL)
                continue
            asked = [self._ask() for _ in range(size)]
            trials = [t for t in asked if t is not None and not self._is_known(t)]
            if trials:
                self._train(trials)
            self._raise_if_stopped()

    def _raise_if_stopped(self) -> None:
        if self.jobs.stop():  # between two jobs
            raise self._interrupted()

    def _ask(self) -> Trial | None:
        """Return a new trial of this process; None if other searches have begun the last ones.

        The seed of its proposal is its place, the lowest that no finished or running trial has, so
        that an interrupted trial is sampled again, and no two searches propose the same values.
        """
        study = self.study
        trial = study.ask()
        claim(trial)
        place = free_place(study, trial)
        if place >= self.settings.n_trials:
            stop(study, trial.number)
            return None
        trial.set_user_attr(PLACE, place)
        study.sampler = self._sampler(place)
        for name, distribution in self.space.items():
            suggest(trial, name, distribution)
        return trial

    def _is_known(self, trial: Trial) -> bool:
        """Give a trial the result of an earlier one with its values; return whether there is one.

        Equal settings give equal runs.
        """
        from optuna.trial import TrialState

        twin = counted_twin(self.study, trial)
        if twin is None:
            return False
        for name in (FAILED, RUN):
            if name in twin.user_attrs:
                trial.set_user_attr(name, twin.user_attrs[name])
        failed = twin.value is None
        self.study.tell(trial, twin.value, state=TrialState.FAIL if failed else None)
        result = "failed" if failed else f"objective {twin.value:.5f}"
        self.tell(f"trial {trial.number} has the values of trial {twin.number}: {result}")
        return True

    def _train(self, trials: Sequence[Trial]) -> None:
        jobs = [[*self.fixed, *(f"{k}={v}" for k, v in t.params.items())] for t in trials]
        try:
            with heartbeat(trials):
                results = self._launch(jobs, [run_number(self.study, trial) for trial in trials])
        except BaseException:
            for trial in trials:
                stop(self.study, trial.number)
            raise
        self._record_results(trials, results)

    def _launch(self, jobs: Sequence[Sequence[str]], numbers: Sequence[int]) -> list[JobResult]:
        """Train the jobs; those with consecutive numbers are launched together.

        A launcher numbers its jobs in sequence, and another search may have taken one in between.
        """
        results: list[JobResult] = []
        begin = 0
        for end in range(1, len(jobs) + 1):
            if end < len(jobs) and numbers[end] == numbers[end - 1] + 1:
                continue
            results += self.jobs.launch(jobs[begin:end], numbers[begin])
            if len(results) < end:  # interrupted
                break
            begin = end
        return results

    def _sampler(self, count: int) -> Any:
        from optuna.samplers import RandomSampler, TPESampler

        seed = int(np.random.SeedSequence([self.settings.seed, count]).generate_state(1)[0])
        return (TPESampler if self.settings.sampler == "tpe" else RandomSampler)(seed=seed)

    def _record_results(self, trials: Sequence[Trial], results: Sequence[JobResult]) -> None:
        problems = [
            self._record_result(trial, result)
            for trial, result in zip(trials, results, strict=False)  # fewer after an interrupt
        ]
        for trial in trials[len(results) :]:
            stop(self.study, trial.number)
        for problem in filter(None, problems):
            if isinstance(problem, InterruptedRunError):
                raise self._interrupted() from problem
            raise problem

    def _interrupted(self) -> InterruptedRunError:
        done = f"{len(finished(self.study))} of {self.settings.n_trials} trials are finished"
        return InterruptedRunError(
            f"interrupted; {done}. Continue with: {sweep_command(self.jobs.folder)}"
        )

    def _record_result(self, trial: Trial, result: JobResult) -> Exception | None:
        """Record the result of a trial; return the error that stops the search, if any."""
        from optuna.exceptions import UpdateFinishedTrialError

        try:
            return self._conclude_trial(trial, result)
        except UpdateFinishedTrialError:  # its heartbeat was missing for too long
            self.tell(f"trial {trial.number} is lost: another search has closed it")
            return None

    def _conclude_trial(self, trial: Trial, result: JobResult) -> Exception | None:
        from optuna.trial import TrialState

        study, value, error = self.study, result.value, result.error
        if error is not None:
            if isinstance(error, NonFiniteError | PluginFailedError):
                trial.set_user_attr(FAILED, True)  # a result: these settings do not work
                study.tell(trial, state=TrialState.FAIL)
                self.tell(f"trial {trial.number} failed: {error}")
                return None
            stop(study, trial.number)
            return error
        if value is None:
            stop(study, trial.number)
            return RequestError("train.validate_every: a search needs a validation in each run")
        trial.set_user_attr(RUN, str(result.folder))
        study.tell(trial, value)
        best = study.best_trial
        self.tell(
            f"trial {trial.number}: objective {value:.5f}; "
            f"best {best.value:.5f} (trial {best.number})"
        )
        return None

    def conclude(self) -> None:
        """Write ``optimization_results.yaml`` into the search's folder, and report the best trial.

        Raises:
            FlipperctlError: every trial failed.
        """
        study = self.study
        if not any(trial.value is not None for trial in finished(study)):
            raise FlipperctlError("every trial of the search failed; see the messages above")
        best = study.best_trial
        run = run_of(best, self.jobs.folder)
        results = {
            "name": "optuna",
            "best_params": best.params,
            "best_value": best.value,
            "best_run": str(run),
        }
        OmegaConf.save(OmegaConf.create(results), self.jobs.folder / "optimization_results.yaml")
        settings = " ".join(f"{key}={value}" for key, value in best.params.items())
        self.tell(
            f"\nBest of {len(finished(study))} trials: {settings}, objective {best.value:.5f}.\n"
            f"Evaluate: {command('eval', '--checkpoint', run)}"
        )
