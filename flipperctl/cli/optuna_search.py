"""``hydra/sweeper=optuna``: a search over intervals and lists that resumes after any stop.

In: overrides, of which some are ``interval(…)``, ``tag(log,interval(…))`` or lists. Out: one
training for each trial, the study in ``storage``, ``optimization_results.yaml`` in the sweep's
folder. Optuna proposes, Hydra's launcher trains. (Hydra's own plugin, hydra-optuna-sweeper 1.3,
needs Optuna 2, whose storage fails with SQLAlchemy 2, and repeats every trial after a restart.)
"""

from __future__ import annotations

import sys
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
from flipperctl.cli.search import SearchSettings, search_space
from flipperctl.cli.sweep_stop import stopping
from flipperctl.cli.sweeps import SweepLauncher, command_to_go_on, uses_default_naming
from flipperctl.cli.training import quote_path
from flipperctl.errors import (
    ConfigError,
    FlipperctlError,
    InterruptedRunError,
    MissingExtraError,
    RequestError,
)
from flipperctl.files import make_folder
from flipperctl.messages import explain
from flipperctl.training.lock import hold

if TYPE_CHECKING:
    from optuna import Study
    from optuna.distributions import BaseDistribution
    from optuna.trial import FrozenTrial, Trial

_FAILED = "failed"  # marks a trial whose training failed; Optuna's FAIL also marks interrupted ones

_MEASURE, _AT_100_HZ = "measure", "pitch_variation_100hz"
"""Name and value of a study's attribute: the θ̂_R in its objective; earlier versions wrote none."""


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

    The proposals depend only on the seed and the finished trials, so a resumed search has the same
    results as an uninterrupted one.
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
        study = self._study(arguments)
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
        for trial in study.get_trials(deepcopy=False):
            if not trial.state.is_finished():  # of a process that was killed
                _stop(study, trial.number)
        if known := len(_finished(study)):
            _print_message(f"the study {study.study_name!r} has {known} finished trials already")
        while (count := len(_finished(study))) < self.settings.n_trials:
            study.sampler = self._sampler(count)
            size = min(self.settings.n_jobs, self.settings.n_trials - count)
            trials = [study.ask(space) for _ in range(size)]
            jobs = [[*fixed, *(f"{k}={v}" for k, v in t.params.items())] for t in trials]
            returns = self.jobs.launch(jobs, initial_job_idx=trials[0].number)
            self._record_results(study, trials, returns)
            if self.jobs.stop():  # between two jobs
                raise self._interrupted(study)

    def _study(self, arguments: Sequence[str]) -> Study:
        import optuna
        from sqlalchemy.exc import SQLAlchemyError

        name, storage = self.settings.study_name, self.settings.storage
        try:
            study = optuna.create_study(
                storage=storage, study_name=name, direction="maximize", load_if_exists=True
            )
        except (SQLAlchemyError, ImportError, ValueError) as error:
            reason = " ".join(str(error).split("\n(Background")[0].split())
            raise ConfigError(
                f"hydra.sweeper.storage: {storage!r} cannot be used: {reason}; "
                "a database URL is allowed, as in sqlite:///search.db"
            ) from error
        asked = sorted(arguments)
        searched = study.user_attrs.get("overrides", asked)
        if searched != asked:
            raise ConfigError(
                f"hydra.sweeper.study_name: the study {name!r} in {storage} searched "
                f"{' '.join(searched)}; give the same overrides, or another study_name"
            )
        if study.user_attrs.get(_MEASURE) != _AT_100_HZ and _finished(study):
            raise ConfigError(
                f"hydra.sweeper.study_name: the trials of the study {name!r} in {storage} are "
                "ordered by θ̂_R at decisions, as in earlier versions, and cannot be compared with "
                "new ones, which are ordered by θ̂_R at 100 Hz; give another study_name"
            )
        study.set_user_attr("overrides", asked)
        study.set_user_attr(_MEASURE, _AT_100_HZ)
        return study

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
            _stop(study, trial.number)
        for problem in filter(None, problems):
            if isinstance(problem, InterruptedRunError):
                raise self._interrupted(study) from problem
            raise problem

    def _interrupted(self, study: Study) -> InterruptedRunError:
        done = f"{len(_finished(study))} of {self.settings.n_trials} trials are finished"
        again = command_to_go_on(self.folder)
        return InterruptedRunError(f"interrupted; {done}. Go on with: {again}")

    def _record_result(self, study: Study, trial: Trial, job: JobReturn) -> Exception | None:
        """Record the result of a trial; return the error that stops the search, if any."""
        from optuna.trial import TrialState

        value, error = job_result(job)
        if error is not None:
            if isinstance(error, FlipperctlError) and error.exit_code == FlipperctlError.exit_code:
                trial.set_user_attr(_FAILED, True)  # a result: these settings do not work
                study.tell(trial, state=TrialState.FAIL)
                _print_message(f"trial {trial.number} failed: {error}")
                return None
            _stop(study, trial.number)
            return error
        if value is None:
            _stop(study, trial.number)
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
        if not any(trial.value is not None for trial in _finished(study)):
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
            f"\nBest of {len(_finished(study))} trials: {settings}, objective {best.value:.5f}.\n"
            f"Evaluate: flipperctl eval --checkpoint {quote_path(Path(best.user_attrs['run']))}"
        )


def _finished(study: Study) -> list[FrozenTrial]:
    """Return the trials that count: those trained to the end, and those whose training failed."""
    return [
        trial
        for trial in study.get_trials(deepcopy=False)
        if trial.value is not None or _FAILED in trial.user_attrs
    ]


def _stop(study: Study, number: int) -> None:
    """Close a trial that was killed or interrupted; it does not count and is sampled again."""
    from optuna.trial import TrialState

    study.tell(number, state=TrialState.FAIL)


def _print_message(text: str) -> None:
    print(text, file=sys.stderr)
