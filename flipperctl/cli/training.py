"""A training run as the command line starts it: files, progress, Ctrl-C and the final message."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

from omegaconf import OmegaConf

from flipperctl import checkpoint
from flipperctl.cli.follow_up import command
from flipperctl.cli.notices import print_notices
from flipperctl.cli.progress import progress
from flipperctl.cli.swing import swing_text
from flipperctl.config import TrainConfig, container, with_overrides
from flipperctl.errors import (
    FlipperctlError,
    InterruptedRunError,
    OutputError,
    RequestError,
    WriteError,
)
from flipperctl.files import make_folder, write_bytes
from flipperctl.training import run_folder
from flipperctl.training.closing import open_all
from flipperctl.training.events import MetricsCsv, TensorBoard
from flipperctl.training.lock import hold
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
    try:
        with hold(directory):
            if run_folder.holds_run(directory):
                raise OutputError(
                    f"{directory} already holds a run; resume it with: "
                    f"{command('train', '--resume', directory)}, or choose another hydra.run.dir"
                )
            run_folder.clear_leftovers(directory)
            trainer = Trainer(config, directory)
            make_folder(directory / checkpoint.BEST.parent)
            keep_more()
            try:
                return _train(trainer, None)
            except RequestError:
                if trainer.progress.decision == 0:  # the corrected request may have the directory
                    run_folder.discard(directory)
                raise
    finally:
        with contextlib.suppress(OSError):  # it holds files
            directory.rmdir()


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
        spent = trainer.progress.decision >= config.train.decisions
        if spent and run_folder.is_finished(directory, trainer.progress.decision):
            print(
                f"nothing left to do: {directory} has trained "
                f"{trainer.progress.decision} decisions, and train.decisions is "
                f"{config.train.decisions}; give a larger train.decisions=… to continue",
                file=sys.stderr,
            )
            return
        _train(trainer, trainer.progress.decision)


def _train(trainer: Trainer, resume_at: int | None) -> dict[str, Any]:
    config, directory = trainer.config, trainer.directory
    write_bytes(directory / run_folder.CONFIG, OmegaConf.to_yaml(container(config)).encode())
    metrics, terms = directory / run_folder.METRICS, list(config.rewards)
    trainer.listeners += open_all(
        [
            lambda: MetricsCsv(metrics, terms, config.randomise.names, resume_at),
            lambda: TensorBoard(directory / run_folder.TENSORBOARD, resume_at),
            lambda: progress(config.train.decisions, trainer.progress.decision),
        ]
    )
    try:
        with _interrupts() as stop:
            summary = trainer.run(stop)
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


@contextlib.contextmanager
def _interrupts() -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether Ctrl-C was pressed or SIGTERM was sent.

    The first signal asks the trainer to stop after the episode; a second one stops at once.
    """
    asked = False

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        print("\nfinishing the episode and saving …", file=sys.stderr)

    signals = (signal.SIGINT, signal.SIGTERM)
    try:
        before = {number: signal.signal(number, ask) for number in signals}
    except ValueError:  # not in the main thread: the launcher handles signals
        before = {}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
