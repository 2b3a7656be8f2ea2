"""The runs of a search's trials, as they lie in the folder of its sweep.

In: a study, and the sweep's folder, which may have been moved since a trial was trained. Out: the
run of a trial, and the finished runs in the folder.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from flipperctl.checkpoint import job_order
from flipperctl.results import SUMMARY
from flipperctl.runs.comparison import SweepRun, sweep_run
from flipperctl.runs.trials import RUN, finished

if TYPE_CHECKING:
    from optuna import Study
    from optuna.trial import FrozenTrial


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
