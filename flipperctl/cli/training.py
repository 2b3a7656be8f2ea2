"""A training run as the command line starts it: files, progress, Ctrl-C and the final message."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from flipperctl import checkpoint
from flipperctl.checkpoint import Checkpoint
from flipperctl.config import TrainConfig, container, with_overrides
from flipperctl.errors import (
    FlipperctlError,
    InterruptedRunError,
    OutputError,
    RequestError,
    WriteError,
)
from flipperctl.files import make_folder, write_bytes
from flipperctl.runs import folder as run_folder
from flipperctl.runs.interrupts import interrupts
from flipperctl.runs.lock import hold
from flipperctl.terminal.follow_up import command, quote_path
from flipperctl.terminal.notices import print_notices
from flipperctl.terminal.pitch_variation import swing_text
from flipperctl.terminal.progress import progress
from flipperctl.training.closing import open_all
from flipperctl.training.events import MetricsCsv
from flipperctl.training.loggers import openers
from flipperctl.training.trainer import Trainer


def start(
    config: TrainConfig, directory: Path, keep_more: Callable[[], None] = lambda: None
) -> dict[str, Any]:
    """Train in a new run directory; return the summary.

    ``keep_more`` writes further files into it, once it is known to be new and locked.

    Raises:
        RunHeldError: another process is training in it.
        OutputError: it already holds a run.
        RequestError: the training cannot begin; nothing of it is left in the directory.
    """
    make_folder(directory)
    with _held(directory):
        if run_folder.holds_run(directory):
            raise OutputError(
                f"{directory} already holds a run; resume it with: "
                f"{command('train', '--resume', directory)}, or choose another hydra.run.dir"
            )
        return _begin(config, directory, keep_more)


def start_or_go_on(
    config: TrainConfig,
    directory: Path,
    keep_more: Callable[[], None],
    stop: Callable[[], bool],
) -> dict[str, Any]:
    """Train one run of a sweep, from where an earlier start of the sweep left it.

    A finished run is left alone. ``stop``, called between episodes, ends the run as Ctrl-C does.

    Raises:
        InterruptedRunError: the run was stopped; all is saved.
        RunHeldError: another process is training in it.
        OutputError: it holds a run with other settings.
        RequestError: the training cannot begin; nothing of it is left in the directory.
    """
    make_folder(directory)
    with _held(directory):
        if not run_folder.holds_run(directory):
            return _begin(config, directory, keep_more, stop)
        saved, earlier = run_folder.read(directory)
        if differing := run_folder.differing_settings(earlier, config):
            raise OutputError(
                f"{directory} already holds a run with other settings "
                f"({', '.join(differing[:3])}{' …' if len(differing) > 3 else ''}); "
                "choose another hydra.sweep.dir"
            )
        if (summary := run_folder.finished(directory, config.train.decisions)) is not None:
            print(f"{quote_path(directory)} is finished", file=sys.stderr)
            return summary
        return _go_on(config, directory, saved, stop)


@contextlib.contextmanager
def _held(directory: Path) -> Iterator[None]:
    """Hold the directory; remove it behind a training that left nothing in it."""
    try:
        with hold(directory):
            yield
    finally:
        with contextlib.suppress(OSError):  # it holds files
            directory.rmdir()


def _begin(
    config: TrainConfig,
    directory: Path,
    keep_more: Callable[[], None],
    stop: Callable[[], bool] = lambda: False,
) -> dict[str, Any]:
    run_folder.clear_leftovers(directory)
    trainer = Trainer(config, directory)
    make_folder(directory / checkpoint.BEST.parent)
    keep_more()
    try:
        return _train(trainer, None, stop)
    except RequestError:
        if trainer.progress.decision == 0:  # the corrected request may have the directory
            run_folder.discard(directory, config.logger)
        raise


def resume_run(run: Path, changes: dict[str, Any], check: Callable[[TrainConfig], None]) -> None:
    """Resume a run from its last full checkpoint, or from its start if it has none.

    ``changes`` are merged into its configuration; ``check`` may refuse the result.

    Raises:
        RunHeldError: another process is training it.
        CheckpointError: ``run`` is not a run, or its checkpoint is damaged.
    """
    directory = run_folder.find(run)
    with hold(directory):
        saved, config = run_folder.read(directory)
        config = with_overrides(config, changes)
        check(config)
        print_notices(config)
        _go_on(config, directory, saved)


def _go_on(
    config: TrainConfig,
    directory: Path,
    saved: Checkpoint | None,
    stop: Callable[[], bool] = lambda: False,
) -> dict[str, Any]:
    run_folder.clear_leftovers(directory)
    trainer = Trainer(config, directory)
    make_folder(directory / checkpoint.BEST.parent)
    if saved is None:
        print(
            f"{directory} was stopped before its first checkpoint; it begins again "
            "with the same configuration and seed",
            file=sys.stderr,
        )
    else:
        trainer.restore(saved)
    decision = trainer.progress.decision
    summary = run_folder.finished(directory, decision)
    if decision >= config.train.decisions and summary is not None:
        print(
            f"nothing left to do: {directory} has trained {decision} decisions, and "
            f"train.decisions is {config.train.decisions}; give a larger train.decisions=… to "
            "continue",
            file=sys.stderr,
        )
        return summary
    return _train(trainer, decision, stop)


def _train(trainer: Trainer, resume_at: int | None, stop: Callable[[], bool]) -> dict[str, Any]:
    config, directory = trainer.config, trainer.directory
    write_bytes(directory / run_folder.CONFIG, OmegaConf.to_yaml(container(config)).encode())
    metrics, terms = directory / run_folder.METRICS, list(config.rewards)
    trainer.listeners += open_all(
        [
            lambda: MetricsCsv(metrics, terms, config.randomise.names, resume_at),
            *openers(config, directory, resume_at),
            lambda: progress(config.train.decisions, trainer.progress.decision),
        ]
    )
    try:
        with interrupts("finishing the episode and saving …") as interrupted:
            summary = trainer.run(lambda: interrupted() or stop())
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
    best = summary["best"]
    print(
        f"\nBest validation at decision {best['decision']}: success {best['success_rate']:.0%}, "
        f"{swing_text(best, 2)}, {best['t_cost']:.1f} s. "
        f"{summary['decisions']} decisions in {summary['seconds']:.0f} s.\n"
        f"Evaluate: {command('eval', '--checkpoint', directory)}\n"
        f"Export:   {command('export', 'onnx', '--checkpoint', directory)}",
        file=sys.stderr,
    )
    return summary
