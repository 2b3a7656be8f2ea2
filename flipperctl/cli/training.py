"""A training run as the command line starts it: files, progress, Ctrl-C, closing words."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from omegaconf import OmegaConf

from flipperctl import checkpoint
from flipperctl.cli.progress import progress
from flipperctl.config import TrainConfig, container
from flipperctl.errors import CheckpointError, InterruptedRunError, OutputError
from flipperctl.files import make_folder, write_bytes
from flipperctl.training.events import MetricsCsv, TensorBoard
from flipperctl.training.trainer import Trainer


def start(config: TrainConfig, directory: Path) -> dict[str, Any]:
    """Train in a new run directory; returns the summary."""
    if (directory / "config.yaml").exists():
        raise OutputError(
            f"{directory} already holds a run; go on with --resume, or choose another hydra.run.dir"
        )
    trainer = Trainer(config, directory)
    make_folder(directory / checkpoint.BEST.parent)
    return _train(trainer, None)


def go_on(config: TrainConfig, saved: checkpoint.Checkpoint) -> None:
    """Go on with a run from its last full checkpoint."""
    if saved.document.kind != "last":
        raise CheckpointError(
            f"{saved.path} holds only the weights of a policy; "
            f"{checkpoint.LAST} is what a run goes on from"
        )
    directory = saved.path.parent.parent
    trainer = Trainer(config, directory)
    trainer.restore(saved)
    if trainer.decision >= config.train.decisions:
        print(
            f"nothing left to do: {directory} has used its budget of {config.train.decisions} "
            "decisions; a larger train.decisions=… goes on",
            file=sys.stderr,
        )
        return
    _train(trainer, trainer.decision)


def _train(trainer: Trainer, resume_at: int | None) -> dict[str, Any]:
    config, directory = trainer.config, trainer.directory
    write_bytes(directory / "config.yaml", OmegaConf.to_yaml(container(config)).encode())
    trainer.listeners += [
        MetricsCsv(
            directory / "metrics.csv", list(config.rewards), config.randomise.names, resume_at
        ),
        TensorBoard(directory / "tensorboard", resume_at),
        progress(config.train.decisions, trainer.decision),
    ]
    with _interrupts() as stop:
        summary = trainer.run(stop)
    shown = _shown(directory)
    if not summary["finished"]:
        raise InterruptedRunError(
            f"interrupted at decision {trainer.decision}; all is saved. "
            f"Go on with: flipperctl train --resume {shown}"
        )
    best = summary["best"]
    print(
        f"\nBest validation at decision {best['decision']}: success {best['success_rate']:.0%}, "
        f"θ̂_R {best['pitch_variation']:.2f} rad, {best['t_cost']:.1f} s. "
        f"{summary['decisions']} decisions in {summary['seconds']:.0f} s.\n"
        f"Evaluate: flipperctl eval --checkpoint {shown}\n"
        f"Export:   flipperctl export onnx --checkpoint {shown}",
        file=sys.stderr,
    )
    return summary


def _shown(directory: Path) -> Path:
    here = Path.cwd()
    return directory.relative_to(here) if directory.is_relative_to(here) else directory


@contextmanager
def _interrupts() -> Iterator[Callable[[], bool]]:
    """Yield a function that says whether Ctrl-C was pressed (or SIGTERM sent).

    The first asks the trainer to stop behind the episode; a second one stops at once.
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
    except ValueError:  # not in the main thread: a launcher's business
        before = {}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
