"""Train in a run directory: start, continue or resume a run, with its lock, files and Ctrl-C.

In: a training's configuration and a directory. Out: the files of the run, and its summary. Nothing
is printed here; ``Reports`` holds the caller's callbacks.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch

from flipperctl import checkpoint
from flipperctl.api import Listener
from flipperctl.checkpoint import Checkpoint
from flipperctl.config import TrainConfig, with_overrides
from flipperctl.errors import (
    CheckpointError,
    FlipperctlError,
    InterruptedRunError,
    OutputError,
    RequestError,
    RunHeldError,
    WriteError,
)
from flipperctl.files import make_folder
from flipperctl.results import METRICS, finished, hold, holds_run, names
from flipperctl.runs import folder as run_folder
from flipperctl.runs.final_regret import FinalRegret
from flipperctl.runs.follow_up import command, quote_path
from flipperctl.runs.interrupts import interrupts
from flipperctl.runs.preflight import check_device, require_kept
from flipperctl.training.closing import open_all
from flipperctl.training.events import MetricsCsv
from flipperctl.training.loggers import openers
from flipperctl.training.trainer import Trainer


@dataclass(frozen=True)
class Reports:
    """Callbacks of the caller of a training; none by default."""

    listeners: Sequence[Callable[[int, int], Listener]] = ()
    """Each returns a listener, given the total number of decisions and of those already made."""
    tell: Callable[[str], None] = lambda text: None
    """Called with a line about where the run begins, or that there is nothing to train."""


@dataclass(frozen=True)
class Finished:
    """A run that is trained to its end."""

    directory: Path
    summary: dict[str, Any]
    """Contents of ``summary.json``."""
    trained: bool
    """Whether this call trained it; False if it was finished before."""


def start(
    config: TrainConfig,
    directory: Path,
    reports: Reports = Reports(),  # frozen
    *,
    keep_more: Callable[[Path], None] = lambda place: None,
    numbered: bool = False,
) -> Finished:
    """Train in a new run directory.

    ``keep_more`` writes further files into it, once it is known to be new and locked. ``numbered``:
    if it has a run, or another process trains there, take the first free of ``…_2``, ``…_3``, ….

    Raises:
        InterruptedRunError: the run was stopped by Ctrl-C; all is saved.
        RunHeldError: another process is training in it.
        OutputError: it already holds a run.
        RequestError: the training cannot begin; nothing of it is left in the directory.
    """
    with _kept_threads():
        for place in names(directory, numbered=numbered):
            make_folder(place)
            held = contextlib.ExitStack()
            try:
                held.enter_context(_held(place))
            except RunHeldError:
                if not numbered:
                    raise
                continue
            with held:
                if not holds_run(place):
                    return _begin(config, place, reports, partial(keep_more, place))
        raise OutputError(
            f"{directory} already holds a run; resume it with: "
            f"{command('train', '--resume', directory)}, or choose another hydra.run.dir"
        )


def start_or_continue(
    config: TrainConfig,
    directory: Path,
    reports: Reports = Reports(),  # frozen
    *,
    keep_more: Callable[[], None] = lambda: None,
    stop: Callable[[], bool] = lambda: False,
) -> Finished:
    """Train one run of a sweep, from where an earlier start of the sweep left it.

    A finished run is not changed. If ``stop``, called between episodes, returns True, the run ends
    as after Ctrl-C.

    Raises:
        InterruptedRunError: the run was stopped; all is saved.
        RunHeldError: another process is training in it.
        OutputError: it holds a run with other settings.
        RequestError: the training cannot begin; nothing of it is left in the directory.
    """
    make_folder(directory)
    with _held(directory), _kept_threads():
        if not holds_run(directory):
            return _begin(config, directory, reports, keep_more, stop)
        saved, earlier = run_folder.read(directory)
        if differing := run_folder.differing_settings(earlier, config):
            raise OutputError(
                f"{directory} already holds a run with other settings "
                f"({', '.join(differing[:3])}{' …' if len(differing) > 3 else ''}); "
                "choose another hydra.sweep.dir"
            )
        if (summary := finished(directory, config.train.decisions)) is not None:
            reports.tell(f"{quote_path(directory)} is finished")
            return Finished(directory, summary, trained=False)
        return _continue(config, directory, reports, saved, stop)


def resume(
    run: Path,
    changes: Mapping[str, Any],
    reports: Reports = Reports(),  # frozen
    *,
    check: Callable[[TrainConfig], None] = check_device,
) -> Finished:
    """Resume a run from its last full checkpoint, or from its start if it has none.

    ``run`` is its directory or its last checkpoint. ``changes`` are merged into its configuration,
    by their keys, such as ``train.decisions``; ``check`` may refuse the result.

    Raises:
        InterruptedRunError: the run was stopped by Ctrl-C; all is saved.
        RunHeldError: another process is training it.
        CheckpointError: ``run`` is not a run, or its checkpoint is damaged.
        ConfigError: a setting is changed that holds from the start of a run.
    """
    directory = run_folder.find(run)
    with hold(directory), _kept_threads():
        saved, before = run_folder.read(directory)
        config = with_overrides(before, dict(changes))
        if saved is not None and (state := saved.document.state) is not None:
            require_kept(before.train, config.train, state)
        check(config)
        return _continue(config, directory, reports, saved)


@contextlib.contextmanager
def _held(directory: Path) -> Iterator[None]:
    """Lock the directory; remove it afterwards if it is empty."""
    try:
        with hold(directory):
            yield
    finally:
        with contextlib.suppress(OSError):  # it holds files
            directory.rmdir()


@contextlib.contextmanager
def _kept_threads() -> Iterator[None]:
    """Give torch as many threads afterwards as it had before the training."""
    threads = torch.get_num_threads()
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _begin(
    config: TrainConfig,
    directory: Path,
    reports: Reports,
    keep_more: Callable[[], None],
    stop: Callable[[], bool] = lambda: False,
) -> Finished:
    run_folder.check_free(directory)
    run_folder.clear_leftovers(directory)
    trainer = Trainer(config, directory)
    make_folder(directory / checkpoint.BEST.parent)
    keep_more()
    try:
        return _train(trainer, None, reports, stop)
    except RequestError:
        if trainer.progress.decision == 0:  # the corrected request may have the directory
            run_folder.discard(directory, config.logger)
        raise


def _continue(
    config: TrainConfig,
    directory: Path,
    reports: Reports,
    saved: Checkpoint | None,
    stop: Callable[[], bool] = lambda: False,
) -> Finished:
    if saved is None and (directory / checkpoint.BEST).is_file():
        raise CheckpointError(
            f"{directory} lacks {checkpoint.LAST}, from which it would be resumed; its policy can "
            "be evaluated, and a new run can start from it (agent.start_from)"
        )
    run_folder.clear_leftovers(directory)
    trainer = Trainer(config, directory)
    make_folder(directory / checkpoint.BEST.parent)
    if saved is None:
        reports.tell(
            f"{directory} was stopped before its first checkpoint; it begins again "
            "with the same configuration and seed"
        )
    else:
        trainer.restore(saved)
    decision = trainer.progress.decision
    summary = finished(directory, decision)
    if decision >= config.train.decisions and summary is not None:
        reports.tell(
            f"nothing left to do: {directory} has trained {decision} decisions, and "
            f"train.decisions is {config.train.decisions}; give a larger train.decisions=… to "
            "continue"
        )
        return Finished(directory, summary, trained=False)
    return _train(trainer, decision, reports, stop)


def _train(
    trainer: Trainer, resume_at: int | None, reports: Reports, stop: Callable[[], bool]
) -> Finished:
    directory = trainer.directory
    run_folder.write_config(directory, trainer.config)
    trainer.listeners += _listeners(trainer, resume_at, reports)
    try:
        with interrupts("finishing the episode and saving …") as interrupted:

            def stopped() -> bool:
                return interrupted() or stop()

            regret = FinalRegret(trainer.config, directory, stopped, reports.tell)
            summary = trainer.run(stopped, regret)
    except (FlipperctlError, OSError) as error:
        if directory.is_dir():
            raise
        raise WriteError(
            f"{directory} was deleted or moved while the run was training; "
            "nothing more can be saved"
        ) from error
    if not summary["finished"]:
        raise InterruptedRunError(
            f"interrupted at decision {trainer.progress.decision}; all is saved. "
            f"Resume with: {command('train', '--resume', directory)}"
        )
    if regret.interrupted:
        raise InterruptedRunError(
            "interrupted while the best policy was compared with simple rules; the training is "
            "finished and saved. "
            f"Compare with: {command('inspect', 'reward', '--regret', '--checkpoint', directory)}"
        )
    return Finished(directory, summary, trained=True)


def _listeners(trainer: Trainer, resume_at: int | None, reports: Reports) -> list[Listener]:
    """Open the listeners that write the run's files, and then those of the caller."""
    config, directory = trainer.config, trainer.directory
    metrics, terms = directory / METRICS, list(config.rewards)
    total, done = config.train.decisions, trainer.progress.decision
    return open_all(
        [
            lambda: MetricsCsv(metrics, terms, config.randomise.names, resume_at),
            *openers(config, directory, resume_at),
            *(lambda make=make: make(total, done) for make in reports.listeners),
        ]
    )
