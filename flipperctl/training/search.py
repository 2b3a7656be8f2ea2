"""A search over trainings that resumes after any stop: Optuna proposes, the caller trains.

In: a study, new or as earlier searches left it, what it samples, and the sweep that trains its
jobs. Out: one training for each trial, the results in the study, ``optimization_results.yaml`` in
the folder of the sweep.

A study belongs to one search at a time. A trial that was interrupted stays unfinished in it; the
next start trains it on, in its run, before it asks for new ones.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from omegaconf import OmegaConf
from pydantic import Field

from flipperctl.api import Settings
from flipperctl.checkpoint import job_order
from flipperctl.checkpoint.results import SUMMARY
from flipperctl.config import parse
from flipperctl.errors import (
    ConfigError,
    FlipperctlError,
    InterruptedRunError,
    NonFiniteError,
    PluginFailedError,
    RequestError,
    missing_extra,
)
from flipperctl.process.session import command
from flipperctl.text.messages import counted
from flipperctl.training.sweep import JobResult, Sweep, SweepRun, sweep_run

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution
    from optuna.trial import FrozenTrial, Trial

_AT_100_HZ = "pitch_variation_100hz"
"""θ̂_R in the objective, which a study states as its ``measure``."""


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

    It is the mean return if ``best_by``, as in ``train.best_by``, is ``return``. Otherwise it is
    ``success − θ̂_R / (1 + θ̂_R) / episodes``, with θ̂_R at 100 Hz [rad]: the penalty is at most one
    episode. It orders runs as validations are ordered: by success, then by θ̂_R. Return None if
    there was no validation.
    """
    if best is None:
        return None
    if best_by == "return":
        return float(best["mean_return"])
    variation = best["pitch_variation_100hz"]
    penalty = variation / (1.0 + variation) if math.isfinite(variation) else 1.0
    return float(best["success_rate"]) - penalty / episodes


def check_settings(values: Mapping[str, Any]) -> SearchSettings:
    """Return the settings of a search."""
    try:
        import optuna
    except ImportError as error:
        raise missing_extra("hydra/sweeper=optuna", "optuna") from error
    settings = parse(SearchSettings, values, "hydra.sweeper")
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
        key: _numbers(values)
        if isinstance(values, Interval)
        else CategoricalDistribution(list(values))
        for key, values in sampled.items()
    }


def _numbers(interval: Interval) -> BaseDistribution:
    from optuna.distributions import FloatDistribution, IntDistribution

    kind = IntDistribution if interval.whole else FloatDistribution
    try:
        low, high = interval.low, interval.high
        return kind(low, high, log=interval.log)  # type: ignore[arg-type]  # both are of its kind
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
    trials = _Search(settings, study, jobs, space, fixed, tell)
    with _usable(settings.storage):
        with jobs.held():
            trials.run()
        trials.conclude()


def _open_study(settings: SearchSettings, overrides: list[str]) -> Study:
    """Return the study of ``settings``, new or as earlier starts of the same search left it."""
    import optuna

    # A study belongs to one search, which it notes by its overrides and its measure.
    name, url = settings.study_name, settings.storage
    searched = {"overrides": overrides, "measure": _AT_100_HZ}
    with _usable(url, ImportError, ValueError):  # of its driver and of its URL
        study = optuna.create_study(
            storage=url, study_name=name, direction="maximize", load_if_exists=True
        )
    with _usable(url):
        known = {key: study.user_attrs.get(key) for key in searched}
        if study.trials and known != searched:
            raise ConfigError(
                f"hydra.sweeper.study_name: the study {name!r} in {url} searched "
                f"{' '.join(known['overrides'] or ['nothing'])} by {known['measure']}, not by "
                f"{_AT_100_HZ}, or other settings; give the same overrides, or another study_name"
            )
        for key, value in searched.items():
            study.set_user_attr(key, value)
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
        # The cause lies behind Optuna's error; SQLAlchemy adds a link to its text.
        cause = error.__cause__ if isinstance(error, StorageInternalError) else None
        reason = " ".join(str(cause or error).split("\n(Background")[0].split())
        raise ConfigError(
            f"hydra.sweeper.storage: {storage!r} cannot be used: {reason}; "
            "a database URL is allowed, as in sqlite:///search.db"
        ) from error


@dataclass(frozen=True)
class _Search:
    """A search that asks Optuna for trials until ``n_trials`` are finished.

    A proposal depends on the seed, on how many were made before it, and on the finished trials. So
    a search whose trials are trained one by one has equal results, however often it was resumed.
    """

    settings: SearchSettings
    study: Study
    jobs: Sweep
    space: Mapping[str, BaseDistribution]
    fixed: Sequence[str]
    tell: Callable[[str], None]

    def run(self) -> None:
        """Train trial after trial."""
        # Runs of earlier starts appear in the comparison as well.
        if known := len(self._finished()):
            self.tell(f"the study {self.study.study_name!r} has {known} finished trials already")
            self.jobs.runs += self._finished_runs()
        while (left := self.settings.n_trials - len(self._finished())) > 0:
            self._train(self._next(min(self.settings.n_jobs, left)))
            if self.jobs.stop():  # between two jobs
                raise self._interrupted()

    def _sampled(self) -> list[FrozenTrial]:
        """Return the trials whose values are sampled; a kill may leave one that lacks some."""
        trials = self.study.get_trials(deepcopy=False)
        return [trial for trial in trials if trial.params.keys() == self.space.keys()]

    def _finished(self) -> list[FrozenTrial]:
        return [trial for trial in self._sampled() if trial.state.is_finished()]

    def _next(self, size: int) -> list[FrozenTrial | Trial]:
        """Return trials to be trained: interrupted ones, then new ones."""
        from optuna.samplers import RandomSampler, TPESampler

        # Interrupted trials go on in their runs before new ones are proposed.
        trials: list[FrozenTrial | Trial] = []
        trials += [trial for trial in self._sampled() if not trial.state.is_finished()][:size]
        sampler = TPESampler if self.settings.sampler == "tpe" else RandomSampler
        while len(trials) < size:
            # A resumed process would repeat the first proposals of a sampler with one seed.
            key = [self.settings.seed, len(self._sampled())]
            seed = int(np.random.SeedSequence(key).generate_state(1)[0])
            self.study.sampler = sampler(seed=seed)
            trials.append(self.study.ask(dict(self.space)))
        return trials

    def _train(self, trials: Sequence[FrozenTrial | Trial]) -> None:
        """Train trials at once, and record their results."""
        problems: list[Exception | None] = []
        # A launcher numbers its jobs in sequence: only successive trials go together.
        for _, group in itertools.groupby(enumerate(trials), lambda item: item[1].number - item[0]):
            batch = [trial for _, trial in group]  # a launcher numbers its jobs in sequence
            jobs = [[*self.fixed, *(f"{k}={v}" for k, v in t.params.items())] for t in batch]
            results = self.jobs.launch(jobs, batch[0].number)
            for trial, result in zip(batch, results, strict=False):  # fewer after an interrupt
                problems.append(self._record(trial.number, result))
        # Errors are raised once the results of all are recorded.
        for problem in filter(None, problems):
            if isinstance(problem, InterruptedRunError):
                raise self._interrupted() from problem
            raise problem

    def _record(self, number: int, result: JobResult) -> Exception | None:
        """Record the result of a trial; return the error that stops the search, if any."""
        from optuna.trial import TrialState

        value, error = result.value, result.error
        if isinstance(error, NonFiniteError | PluginFailedError):
            # This, too, is a result: the values do not work.
            self.study.tell(number, state=TrialState.FAIL)
            self.tell(f"trial {number} failed: {error}")
        elif error is not None or value is None:
            missing = "train.validate_every: a search needs a validation in each run"
            return error or RequestError(missing)
        else:
            self.study.set_user_attr(f"run {number}", str(result.folder))
            self.study.tell(number, value)
            best = self.study.best_trial
            self.tell(
                f"trial {number}: objective {value:.5f}; "
                f"best {best.value:.5f} (trial {best.number})"
            )
        return None

    def _interrupted(self) -> InterruptedRunError:
        done = f"{len(self._finished())} of {self.settings.n_trials} trials are finished"
        return InterruptedRunError(f"interrupted; {done}. Continue with: {self.jobs.command()}")

    def _run_of(self, trial: FrozenTrial) -> Path:
        """Return the run of a trained trial, below the search's folder if that was moved."""
        run = Path(self.study.user_attrs[f"run {trial.number}"])
        moved = self.jobs.folder.absolute() / run.name
        return moved if not run.exists() and moved.exists() else run

    def _finished_runs(self) -> Iterator[SweepRun]:
        """Yield each run of finished trials in the folder; earlier starts may have had another."""
        for trial in self._finished():
            run = None if trial.value is None else self._run_of(trial)  # None: it failed
            if run is None or not run.is_relative_to(self.jobs.folder.absolute()):
                continue
            if (run / SUMMARY).is_file():
                values = {name.lstrip("+~"): str(value) for name, value in trial.params.items()}
                yield sweep_run(job_order(run)[0], values, run, None)

    def conclude(self) -> None:
        """Write ``optimization_results.yaml``, and report the best trial."""
        if all(trial.value is None for trial in self._finished()):
            raise FlipperctlError("every trial of the search failed; see the messages above")
        best = self.study.best_trial
        run = self._run_of(best)
        results = {"best_params": best.params, "best_value": best.value, "best_run": str(run)}
        document = OmegaConf.create({"name": "optuna", **results})
        OmegaConf.save(document, self.jobs.folder / "optimization_results.yaml")
        settings = " ".join(f"{key}={value}" for key, value in best.params.items())
        self.tell(
            f"\nBest of {counted(len(self._finished()), 'trial')}: {settings}, "
            f"objective {best.value:.5f}.\n"
            f"Evaluate: {command('eval', run)}"
        )
