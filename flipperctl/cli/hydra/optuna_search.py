"""``hydra/sweeper=optuna``: a search over intervals and lists that resumes after any stop.

In: overrides, of which some are ``interval(…)``, ``tag(log,interval(…))`` or lists. Out: one
training for each trial, the study in ``storage``, ``optimization_results.yaml`` in the sweep's
folder. Optuna proposes, Hydra's launcher trains. (Hydra's own plugin, hydra-optuna-sweeper 1.3,
needs Optuna 2, whose storage fails with SQLAlchemy 2, and repeats every trial after a restart.)
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf
from pydantic import ValidationError

from flipperctl.cli.comparison import compare, job_result
from flipperctl.cli.hydra.search_space import search_space
from flipperctl.cli.hydra.sweeps import SweepLauncher, command_to_go_on, uses_default_naming
from flipperctl.errors import (
    ConfigError,
    FlipperctlError,
    InterruptedRunError,
    MissingExtraError,
    RequestError,
)
from flipperctl.files import make_folder
from flipperctl.messages import explain
from flipperctl.runs.lock import hold
from flipperctl.runs.search import SearchSettings
from flipperctl.runs.study import open_study
from flipperctl.runs.sweep_stop import stopping
from flipperctl.runs.trial_owner import claim, signs_of_life
from flipperctl.runs.trials import FAILED, fail_abandoned, finished, running, stop, suggest
from flipperctl.terminal.follow_up import command

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution
    from optuna.trial import Trial

_POLL = 1.0
"""Time between two looks at the trials of other searches [s]."""


def prepare(
    sweeper_settings: Mapping[str, Any],
    *,
    hydra_context: HydraContext,
    task_function: TaskFunction,
    config: DictConfig,
) -> OptunaSearch:
    """Return the search that Hydra's configuration describes, with Hydra's launcher.

    Raises:
        MissingExtraError: Optuna is not installed.
        ConfigError: one of ``sweeper_settings`` is of the wrong type or out of bounds.
    """
    try:
        import optuna
    except ImportError as error:
        raise MissingExtraError(
            "hydra/sweeper=optuna needs the package optuna; install flipperctl[optuna]"
        ) from error
    try:
        settings = SearchSettings(**sweeper_settings)
    except ValidationError as error:
        raise ConfigError(explain(error, "hydra.sweeper", SearchSettings)) from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    launcher: Launcher = Plugins.instance().instantiate_launcher(
        config=config, hydra_context=hydra_context, task_function=task_function
    )
    folder = Path(config.hydra.sweep.dir)
    jobs = SweepLauncher(launcher, folder, named=uses_default_naming(config))
    return OptunaSearch(settings, jobs, folder)


@dataclass(frozen=True)
class OptunaSearch:
    """A search that asks Optuna for trials until ``n_trials`` are finished.

    The proposals of one search depend only on the seed and the finished trials, so a resumed search
    has the same results as an uninterrupted one. Several searches may share a study, each in a
    folder of its own.
    """

    settings: SearchSettings
    jobs: SweepLauncher
    folder: Path
    """Folder of the sweep."""

    def run(self, arguments: Sequence[str]) -> None:
        """Train trial after trial; ``arguments`` are the user's overrides.

        Raises:
            RunHeldError: another process works in the sweep's folder.
        """
        space, fixed = search_space(arguments)
        study = open_study(self.settings, arguments)
        self.jobs.swept = list(space)
        with hold(make_folder(self.folder), "sweep"):
            try:
                with stopping(self.folder) as self.jobs.stop:
                    self._search(study, space, fixed)
            finally:
                compare(self.folder, self.jobs.runs)
            self._conclude(study)

    def _search(
        self, study: Study, space: dict[str, BaseDistribution], fixed: Sequence[str]
    ) -> None:
        if known := len(finished(study)):
            _print_message(f"the study {study.study_name!r} has {known} finished trials already")
        awaited = 0
        while (count := len(finished(study))) < self.settings.n_trials:
            fail_abandoned(study)
            others = len(running(study))
            size = min(self.settings.n_jobs, self.settings.n_trials - count - others)
            if size <= 0:
                if others != awaited:
                    _print_message(f"waiting for trials of another search: {others}")
                awaited = others
                self._raise_if_stopped(study)
                time.sleep(_POLL)
                continue
            asked = [self._ask(study, space) for _ in range(size)]
            trials = [trial for trial in asked if trial is not None]
            if trials:
                self._train(study, trials, fixed)
            self._raise_if_stopped(study)

    def _raise_if_stopped(self, study: Study) -> None:
        if self.jobs.stop():  # between two jobs
            raise self._interrupted(study)

    def _ask(self, study: Study, space: dict[str, BaseDistribution]) -> Trial | None:
        """Return a new trial of this process; None if others have begun the last ones meanwhile.

        The seed of its proposal is its place among the trials that count or run, so that an
        interrupted trial is sampled again, and no two searches propose the same.
        """
        trial = study.ask()
        claim(trial)
        place = sum(t.number < trial.number for t in [*finished(study), *running(study)])
        if place >= self.settings.n_trials:
            stop(study, trial.number)
            return None
        study.sampler = self._sampler(place)
        for name, distribution in space.items():
            suggest(trial, name, distribution)
        return trial

    def _train(self, study: Study, trials: Sequence[Trial], fixed: Sequence[str]) -> None:
        jobs = [[*fixed, *(f"{k}={v}" for k, v in t.params.items())] for t in trials]
        try:
            with signs_of_life(trials):
                returns = self._launch(jobs, [trial.number for trial in trials])
        except BaseException:
            for trial in trials:
                stop(study, trial.number)
            raise
        self._record_results(study, trials, returns)

    def _launch(self, jobs: Sequence[Sequence[str]], numbers: Sequence[int]) -> list[JobReturn]:
        """Train the jobs, side by side as far as their numbers follow each other.

        A launcher numbers its jobs in sequence, and another search may have taken one in between.
        """
        returns: list[JobReturn] = []
        begin = 0
        for end in range(1, len(jobs) + 1):
            if end < len(jobs) and numbers[end] == numbers[end - 1] + 1:
                continue
            returns += self.jobs.launch(jobs[begin:end], initial_job_idx=numbers[begin])
            if len(returns) < end:  # interrupted
                break
            begin = end
        return returns

    def _sampler(self, count: int) -> Any:
        from optuna.samplers import RandomSampler, TPESampler

        seed = int(np.random.SeedSequence([self.settings.seed, count]).generate_state(1)[0])
        return (TPESampler if self.settings.sampler == "tpe" else RandomSampler)(seed=seed)

    def _record_results(
        self, study: Study, trials: Sequence[Trial], returns: Sequence[JobReturn]
    ) -> None:
        problems = [
            self._record_result(study, trial, job)
            for trial, job in zip(trials, returns, strict=False)  # fewer after an interrupt
        ]
        for trial in trials[len(returns) :]:
            stop(study, trial.number)
        for problem in filter(None, problems):
            if isinstance(problem, InterruptedRunError):
                raise self._interrupted(study) from problem
            raise problem

    def _interrupted(self, study: Study) -> InterruptedRunError:
        done = f"{len(finished(study))} of {self.settings.n_trials} trials are finished"
        again = command_to_go_on(self.folder)
        return InterruptedRunError(f"interrupted; {done}. Go on with: {again}")

    def _record_result(self, study: Study, trial: Trial, job: JobReturn) -> Exception | None:
        """Record the result of a trial; return the error that stops the search, if any."""
        from optuna.exceptions import UpdateFinishedTrialError

        try:
            return self._tell(study, trial, job)
        except UpdateFinishedTrialError:  # this process had given no sign of life for long
            _print_message(f"trial {trial.number} is lost: another search has closed it")
            return None

    def _tell(self, study: Study, trial: Trial, job: JobReturn) -> Exception | None:
        from optuna.trial import TrialState

        value, error = job_result(job)
        if error is not None:
            if isinstance(error, FlipperctlError) and error.exit_code == FlipperctlError.exit_code:
                trial.set_user_attr(FAILED, True)  # a result: these settings do not work
                study.tell(trial, state=TrialState.FAIL)
                _print_message(f"trial {trial.number} failed: {error}")
                return None
            stop(study, trial.number)
            return error
        if value is None:
            stop(study, trial.number)
            return RequestError("train.validate_every: a search needs a validation in each run")
        composed: Any = job.hydra_cfg
        trial.set_user_attr("run", str(composed.hydra.runtime.output_dir))
        study.tell(trial, value)
        best = study.best_trial
        _print_message(
            f"trial {trial.number}: objective {value:.5f}; "
            f"best {best.value:.5f} (trial {best.number})"
        )
        return None

    def _conclude(self, study: Study) -> None:
        if not any(trial.value is not None for trial in finished(study)):
            raise FlipperctlError("every trial of the search failed; see the messages above")
        best = study.best_trial
        results = {
            "name": "optuna",
            "best_params": best.params,
            "best_value": best.value,
            "best_run": best.user_attrs["run"],
        }
        OmegaConf.save(OmegaConf.create(results), self.folder / "optimization_results.yaml")
        settings = " ".join(f"{key}={value}" for key, value in best.params.items())
        _print_message(
            f"\nBest of {len(finished(study))} trials: {settings}, objective {best.value:.5f}.\n"
            f"Evaluate: {command('eval', '--checkpoint', Path(best.user_attrs['run']))}"
        )


def _print_message(text: str) -> None:
    print(text, file=sys.stderr)
