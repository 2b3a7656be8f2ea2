"""A search over trainings that resumes after any stop: Optuna proposes, the caller trains.

In: a study, new or as earlier searches left it, what it samples, and the sweep that trains its
jobs. Out: one training for each trial, the results in the study, ``optimization_results.yaml`` in
the folder of the sweep.

Several searches may share a study, each in a folder of its own. A trial belongs to the process that
began it; if that process dies, the trial is closed and sampled again: at once where its death can
be seen, elsewhere when Optuna misses its heartbeat.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from omegaconf import OmegaConf
from pydantic import Field, ValidationError

from flipperctl.api import Settings
from flipperctl.checkpoint import job_order
from flipperctl.errors import (
    ConfigError,
    FlipperctlError,
    InterruptedRunError,
    MissingExtraError,
    NonFiniteError,
    PluginFailedError,
    RequestError,
)
from flipperctl.messages import explain
from flipperctl.results import SUMMARY, holder, is_dead
from flipperctl.session import command, sweep_command
from flipperctl.training.sweep import JobResult, Sweep, SweepRun, sweep_run

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution
    from optuna.trial import FrozenTrial, Trial, TrialState

_HEARTBEAT, _GRACE = 15, 120
"""Time between two heartbeats, and after the last one until its process counts as dead [s]."""
_PAUSE = 1.0
"""Time between two looks at what other searches do [s]."""
_MEASURE, _AT_100_HZ = "measure", "pitch_variation_100hz"
"""Attribute of a study that names the θ̂_R in its objective; earlier versions wrote none."""
_OWNER, _PLACE, _RUN, _FAILED = "owner", "place", "run", "failed"
"""Attributes of a trial: its process; its place in the search, which decides what is sampled; the
path of its run; whether its training failed (Optuna's FAIL also marks interrupted trials)."""


class SearchSettings(Settings):
    """The section ``hydra.sweeper`` of a search."""

    n_trials: int = Field(
        20,
        ge=1,
        le=100_000,
        description="finished trials of the whole study, those of earlier starts included",
    )
    n_jobs: int = Field(
        1, ge=1, le=1000, description="trials proposed at once, for a launcher to run side by side"
    )
    storage: str | None = Field(
        None,
        description="URL of the study's database, as in sqlite:///search.db; null: in memory",
    )
    study_name: str = Field("search", min_length=1, description="name of the study in the storage")
    sampler: Literal["tpe", "random"] = Field("tpe", description="Optuna's sampler")
    seed: int = Field(1, ge=0, lt=2**31, description="seed of the proposals")


def objective(best: dict[str, Any] | None, episodes: int, best_by: str = "success") -> float | None:
    """Return the objective that a sweeper maximises, from a run's best validation.

    It is the mean return if ``best_by``, as in ``train.best_by``, is ``return``. Else it is the
    success rate minus a penalty of at most one episode that grows with θ̂_R at 100 Hz [rad]:
    ``success − θ̂_R / (1 + θ̂_R) / episodes``. It orders runs as validations are ordered: by success,
    then by θ̂_R. Return None if there was no validation.
    """
    if best is None:
        return None
    if best_by == "return":
        return float(best["mean_return"])
    variation = best["pitch_variation_100hz"]
    penalty = variation / (1.0 + variation) if math.isfinite(variation) else 1.0
    return float(best["success_rate"]) - penalty / episodes


def check_settings(given: Mapping[str, Any]) -> SearchSettings:
    """Return the settings of a search."""
    try:
        import optuna
    except ImportError as error:
        raise MissingExtraError(
            "hydra/sweeper=optuna needs the package optuna; install flipperctl[optuna]"
        ) from error
    try:
        settings = SearchSettings(**given)
    except ValidationError as error:
        raise ConfigError(explain(error, "hydra.sweeper", SearchSettings)) from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return settings


@dataclass(frozen=True)
class Interval:
    """An interval of numbers, of integers if both ends are integers."""

    low: float
    high: float
    log: bool
    """Whether numbers are sampled on a logarithmic scale."""
    typed: str
    """The override, for errors."""

    @property
    def whole(self) -> bool:
        """Whether the numbers are integers."""
        return isinstance(self.low, int) and isinstance(self.high, int)

    def probes(self) -> tuple[float, float, float]:
        """Return both ends and a number between them, a fraction unless both are integers."""
        between = self.low + 0.3819 * (self.high - self.low)
        return self.low, self.high, self.low if self.whole else between


def distributions(
    sampled: Mapping[str, Interval | Sequence[str]],
) -> dict[str, BaseDistribution]:
    """Return the distribution of each key."""
    from optuna.distributions import CategoricalDistribution

    if not sampled:
        raise ConfigError(
            "hydra/sweeper=optuna has nothing to search; give an interval or a list, as in "
            "'agent.learning_rate=tag(log,interval(1e-4,3e-3))' or agent.batch_size=64,128"
        )
    return {
        key: _numbers(one) if isinstance(one, Interval) else CategoricalDistribution(list(one))
        for key, one in sampled.items()
    }


def _numbers(interval: Interval) -> BaseDistribution:
    from optuna.distributions import FloatDistribution, IntDistribution

    made = IntDistribution if interval.whole else FloatDistribution
    try:
        low, high = interval.low, interval.high
        return made(low, high, log=interval.log)  # type: ignore[arg-type]  # both are of its kind
    except ValueError as error:
        raise ConfigError(f"{interval.typed}: {error}") from error


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
    """
    space = distributions(sampled)
    study = _open_study(settings, sorted(overrides))
    jobs.swept = list(space)
    found = _Search(settings, study, jobs, space, fixed, tell)
    with _usable(settings.storage):
        with jobs.held():
            found.run()
        found.conclude()


def _open_study(settings: SearchSettings, overrides: list[str]) -> Study:
    """Return the study of ``settings``, new or as earlier searches of the same left it."""
    import optuna
    from sqlalchemy.exc import SQLAlchemyError

    name, url = settings.study_name, settings.storage
    # Heartbeats are experimental, and Optuna expects them of study.optimize alone.
    warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
    warnings.filterwarnings("ignore", "Heartbeat of storage")

    def create() -> Study:
        storage = url and optuna.storages.RDBStorage(
            url, heartbeat_interval=_HEARTBEAT, grace_period=_GRACE
        )
        return optuna.create_study(
            storage=storage, study_name=name, direction="maximize", load_if_exists=True
        )

    with _usable(url, ImportError, ValueError):  # of its driver and of its URL
        try:
            study = create()
        except SQLAlchemyError:  # another search may be creating the tables
            time.sleep(_PAUSE)
            study = create()
    with _usable(url):
        known = study.user_attrs
        if (searched := known.get("overrides", overrides)) != overrides:
            raise ConfigError(
                f"hydra.sweeper.study_name: the study {name!r} in {url} searched "
                f"{' '.join(searched)}; give the same overrides, or another study_name"
            )
        if known.get(_MEASURE) != _AT_100_HZ and any(map(_counts, study.get_trials(False))):
            raise ConfigError(
                f"hydra.sweeper.study_name: the trials of the study {name!r} in {url} are "
                "ordered by θ̂_R at decisions, as in earlier versions, and cannot be compared with "
                "new ones, which are ordered by θ̂_R at 100 Hz; give another study_name"
            )
        study.set_user_attr("overrides", overrides)
        study.set_user_attr(_MEASURE, _AT_100_HZ)
    return study


@contextlib.contextmanager
def _usable(storage: str | None, *more: type[Exception]) -> Iterator[None]:
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


def _fail() -> TrialState:
    from optuna.trial import TrialState

    return TrialState.FAIL


def _counts(trial: FrozenTrial) -> bool:
    """Return whether a trial was trained to the end, or has a training that failed."""
    return trial.value is not None or _FAILED in trial.user_attrs


@dataclass(frozen=True)
class _Search:
    """A search that asks Optuna for trials until ``n_trials`` are finished.

    The proposals of one search depend only on the seed and the finished trials, so a resumed search
    whose trials are trained one by one has the same results as an uninterrupted one.
    """

    settings: SearchSettings
    study: Study
    jobs: Sweep
    space: Mapping[str, BaseDistribution]
    fixed: Sequence[str]
    tell: Callable[[str], None]

    def run(self) -> None:
        """Train trial after trial."""
        if known := len(self._finished()):
            self.tell(f"the study {self.study.study_name!r} has {known} finished trials already")
            self.jobs.runs += self._finished_runs()
        awaited = 0
        while (count := len(self._finished())) < self.settings.n_trials:
            self._close_abandoned()
            others = sum(not trial.state.is_finished() for trial in self._trials())
            size = min(self.settings.n_jobs, self.settings.n_trials - count - others)
            if size > 0:
                self._train(size)
            elif others != awaited:
                self.tell(f"waiting for trials of another search: {others}")
            awaited = others
            if self.jobs.stop():  # between two jobs
                raise self._interrupted()
            if size <= 0:
                time.sleep(_PAUSE)

    def _trials(self) -> list[FrozenTrial]:
        return self.study.get_trials(deepcopy=False)

    def _finished(self) -> list[FrozenTrial]:
        return [trial for trial in self._trials() if _counts(trial)]

    def _close_abandoned(self) -> None:
        """Close the trials of processes that died."""
        from optuna.storages import fail_stale_trials

        fail_stale_trials(self.study)
        for trial in self._trials():
            owner = trial.user_attrs.get(_OWNER)
            if (
                not trial.state.is_finished()
                and isinstance(owner, list)
                and is_dead((owner[0], owner[1]))
            ):
                self._close(trial.number)

    def _close(self, number: int) -> None:
        """Close a trial that was stopped; it does not count and is sampled again."""
        self.study.tell(number, state=_fail(), skip_if_finished=True)

    def _ask(self, beating: contextlib.ExitStack) -> Trial | None:
        """Return a new trial of this process; None if other searches have begun the last ones.

        The seed of its proposal is its place, the lowest that no finished or running trial has, so
        that an interrupted trial is sampled again, and no two searches propose the same values.
        """
        from optuna.samplers import RandomSampler, TPESampler
        from optuna.storages._heartbeat import get_heartbeat_thread  # that of study.optimize

        trial = self.study.ask()
        trial.set_user_attr(_OWNER, holder())
        beats: Any = get_heartbeat_thread(trial._trial_id, self.study._storage)
        beating.enter_context(beats)
        place = self._free_place(trial.number)
        if place >= self.settings.n_trials:
            self._close(trial.number)
            return None
        trial.set_user_attr(_PLACE, place)
        seed = int(np.random.SeedSequence([self.settings.seed, place]).generate_state(1)[0])
        sampler = TPESampler if self.settings.sampler == "tpe" else RandomSampler
        self.study.sampler = sampler(seed=seed)
        for name, distribution in self.space.items():
            trial._suggest(name, distribution)
        return trial

    def _free_place(self, number: int) -> int:
        """Return the lowest place that no earlier trial has which counts or runs.

        A trial that has just begun has not noted its own; it counts as the lowest free one.
        """
        taken: set[int] = set()
        free = 0
        for other in self._trials()[:number]:
            if _counts(other) or not other.state.is_finished():
                taken.add(other.user_attrs.get(_PLACE, free))
                free = next(place for place in itertools.count() if place not in taken)
        return free

    def _twins(self, trial: Trial) -> list[FrozenTrial]:
        """Return the closed trials with the values of this one."""
        return [t for t in self._trials() if t.state.is_finished() and t.params == trial.params]

    def _is_known(self, trial: Trial) -> bool:
        """Give a trial the result of an earlier one with its values; return whether there is one.

        Equal settings give equal runs.
        """
        if (twin := next(filter(_counts, self._twins(trial)), None)) is None:
            return False
        for name in {_FAILED, _RUN} & twin.user_attrs.keys():
            trial.set_user_attr(name, twin.user_attrs[name])
        failed = twin.value is None
        self.study.tell(trial, twin.value, state=_fail() if failed else None)
        result = "failed" if failed else f"objective {twin.value:.5f}"
        self.tell(f"trial {trial.number} has the values of trial {twin.number}: {result}")
        return True

    def _train(self, size: int) -> None:
        """Train new trials at once; a trial without a result is closed."""
        with contextlib.ExitStack() as beating:
            asked = [self._ask(beating) for _ in range(size)]
            trials = [trial for trial in asked if trial is not None and not self._is_known(trial)]
            problems: list[Exception | None] = []
            done = 0
            try:
                results = self._launch(trials)
                for trial, result in zip(trials, results, strict=False):  # fewer after an interrupt
                    problems.append(self._record(trial, result))
                    done += 1
            finally:
                for trial in trials[done:]:
                    self._close(trial.number)
        for problem in filter(None, problems):
            if isinstance(problem, InterruptedRunError):
                raise self._interrupted() from problem
            raise problem

    def _launch(self, trials: Sequence[Trial]) -> list[JobResult]:
        """Train the trials' jobs; those with consecutive numbers are launched together.

        A trial goes on in the run of a stopped trial with its values. A launcher numbers its jobs
        in sequence, and another search may have taken a number in between.
        """
        jobs = [[*self.fixed, *(f"{k}={v}" for k, v in t.params.items())] for t in trials]
        numbers = [min([t.number, *(o.number for o in self._twins(t))]) for t in trials]
        results: list[JobResult] = []
        while len(results) < len(jobs):
            begin = end = len(results)
            while end < len(jobs) and numbers[end] == numbers[begin] + end - begin:
                end += 1
            results += self.jobs.launch(jobs[begin:end], numbers[begin])
            if len(results) < end:  # interrupted
                break
        return results

    def _record(self, trial: Trial, result: JobResult) -> Exception | None:
        """Record the result of a trial; return the error that stops the search, if any."""
        from optuna.exceptions import UpdateFinishedTrialError

        value, error = result.value, result.error
        try:
            if isinstance(error, NonFiniteError | PluginFailedError):
                trial.set_user_attr(_FAILED, True)  # a result: these settings do not work
                self.study.tell(trial, state=_fail())
                self.tell(f"trial {trial.number} failed: {error}")
            elif error is not None or value is None:
                self._close(trial.number)
                missing = "train.validate_every: a search needs a validation in each run"
                return error or RequestError(missing)
            else:
                trial.set_user_attr(_RUN, str(result.folder))
                self.study.tell(trial, value)
                best = self.study.best_trial
                self.tell(
                    f"trial {trial.number}: objective {value:.5f}; "
                    f"best {best.value:.5f} (trial {best.number})"
                )
        except UpdateFinishedTrialError:  # its heartbeat was missing for too long
            self.tell(f"trial {trial.number} is lost: another search has closed it")
        return None

    def _interrupted(self) -> InterruptedRunError:
        done = f"{len(self._finished())} of {self.settings.n_trials} trials are finished"
        return InterruptedRunError(
            f"interrupted; {done}. Continue with: {sweep_command(self.jobs.folder)}"
        )

    def _run_of(self, trial: FrozenTrial) -> Path:
        """Return the run of a trained trial, below the search's folder if that was moved."""
        run = Path(trial.user_attrs[_RUN])
        moved = self.jobs.folder.absolute() / run.name
        return moved if not run.exists() and moved.exists() else run

    def _finished_runs(self) -> Iterator[SweepRun]:
        """Yield each run of finished trials in the folder; other searches have theirs elsewhere."""
        trials = {  # trials with equal values share a run; others failed and have none
            self._run_of(trial): trial for trial in self._finished() if _RUN in trial.user_attrs
        }
        for run, trial in trials.items():
            if run.is_relative_to(self.jobs.folder.absolute()) and (run / SUMMARY).is_file():
                values = {name.lstrip("+~"): str(value) for name, value in trial.params.items()}
                yield sweep_run(job_order(run)[0], values, run, None)

    def conclude(self) -> None:
        """Write ``optimization_results.yaml``, and report the best trial."""
        if all(trial.value is None for trial in self._finished()):
            raise FlipperctlError("every trial of the search failed; see the messages above")
        best = self.study.best_trial
        run = self._run_of(best)
        found = {"best_params": best.params, "best_value": best.value, "best_run": str(run)}
        document = OmegaConf.create({"name": "optuna", **found})
        OmegaConf.save(document, self.jobs.folder / "optimization_results.yaml")
        settings = " ".join(f"{key}={value}" for key, value in best.params.items())
        self.tell(
            f"\nBest of {len(self._finished())} trials: {settings}, objective {best.value:.5f}.\n"
            f"Evaluate: {command('eval', run)}"
        )
