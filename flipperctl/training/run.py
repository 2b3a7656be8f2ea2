"""Train in a run directory: start, continue or resume a run, with its lock, files and Ctrl-C.

In: a training's configuration and a directory. Out: the files of the run, and its summary. Nothing
is printed or judged here; ``Reports`` holds the caller's callbacks.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch

from flipperctl import checkpoint
from flipperctl.agent.contract import check_contract
from flipperctl.api import Listener
from flipperctl.checkpoint import Checkpoint
from flipperctl.checkpoint.document import State
from flipperctl.checkpoint.results import METRICS, finished, hold, holds_run, names
from flipperctl.config import Train, TrainConfig, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.repeating import require_repeatable
from flipperctl.errors import (
    CheckpointError,
    ConfigError,
    FlipperctlError,
    InterruptedRunError,
    OutputError,
    RequestError,
    RunHeldError,
    WriteError,
)
from flipperctl.plugging.guard import naming_plugins
from flipperctl.process.session import command, interrupts, quote_path
from flipperctl.text.files import make_folder
from flipperctl.training import folder as run_folder
from flipperctl.training.listeners import MetricsCsv, openers
from flipperctl.training.trainer import Trainer, closer

_RESUMABLE = ("train.", "device", "collector", "logger")
"""What the overrides of a resumed run begin with."""
_JUDGING = ("best_by", "validation_episodes", "validation_seed")
"""Settings of ``train`` that hold from the first validation on, since all compete for the best."""


def check(config: TrainConfig) -> None:
    """Refuse a training whose actions, terrain, device, teacher, network or start do not fit."""
    # A file of somebody else's network has actions of its own, and the default learner.
    if config.actions not in config.agent.drives:
        raise ConfigError(
            f"actions: {config.actions} does not go with agent={config.agent.plugin_name}; "
            f"actions={' or '.join(config.agent.drives)} is allowed; flipperctl list learners "
            "shows others"
        )
    check_device(config)
    # The terrain must build and give the same episode again for the same seed.
    env = FlipperEnv(config=config.environment())
    env.reset(seed=0)
    require_repeatable(env, 0)
    try:
        config.agent.check_start(config)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    check_contract(config.network, config.perception)


def check_resumable(words: Iterable[str]) -> None:
    """Refuse overrides of a resumed run that would make it another run."""
    for word in words:
        if "=" not in word or not word.startswith(_RESUMABLE):
            raise ConfigError(
                f"{word!r}: a resumed run keeps its configuration; only train.<field>=…, "
                "device=…, collector=… and logger=… can be given with --resume"
            )


def require_kept(before: Train, after: Train, state: State) -> None:
    """Refuse changes of a run in this state that would mix ways of judging or collecting."""
    # Judging is fixed by the first validation, recording by the first episode.
    fixed = [*(_JUDGING if state.validations else ()), *(["record"] * (state.episode > 0))]
    fixed += ["mode"] * bool(state.orders)  # workers have begun episodes
    for name in fixed:
        previous, requested = getattr(before, name), getattr(after, name)
        if requested != previous:
            previous, requested = (
                str(v).lower() if isinstance(v, bool) else v for v in (previous, requested)
            )
            raise ConfigError(
                f"train.{name}={requested}: the run goes on with train.{name}={previous}, "
                "which holds for all of it; leave it out, or begin a new run"
            )


def check_device(config: TrainConfig) -> None:
    """Refuse a device that torch cannot use."""
    try:
        torch.zeros(1, device=config.device).item()  # which meta tensors do not have
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"device: {config.device!r} cannot be used: {reason}") from error


Judge = Callable[
    [TrainConfig, Path, Callable[[], bool], Callable[[str], None]], dict[str, Any] | None
]
"""A function of a finished run's configuration and directory, of whether to stop, which it asks
between episodes, and of what shows a line. It returns plain data or None, and may raise
InterruptedRunError."""


@dataclass(frozen=True)
class Reports:
    """Callbacks of the caller of a training; none by default."""

    listeners: Sequence[Callable[[int, int], Listener]] = ()
    """Functions of the total number of decisions and the number already made → listener."""
    tell: Callable[[str], None] = lambda text: None
    """Called with a line about where the run begins, or that there is nothing to train."""
    warn: Callable[[str], None] = lambda text: None
    """Called with a line about a logger that fails, without which the training continues."""
    judge: Judge = lambda config, directory, stop, tell: None
    """Called once the budget is spent; its result is ``regret`` of the run's summary."""


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
    Of a training that is refused before its first decision, nothing is left in the directory.
    """
    for place in names(directory, numbered=numbered):
        make_folder(place)
        with contextlib.ExitStack() as stack:
            try:
                stack.enter_context(_held(place))
            except RunHeldError:
                if not numbered:
                    raise
                continue
            # Only under its lock is it certain that the folder has no run.
            if not holds_run(place):
                return _begin(config, place, reports, partial(keep_more, place))
    raise OutputError(
        f"{directory} already holds a run; resume it with: "
        f"{command('train', '--resume', directory)}, or choose another folder"
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
    """
    make_folder(directory)
    with _held(directory):
        if not holds_run(directory):
            return _begin(config, directory, reports, keep_more, stop)
        saved, earlier = run_folder.read(directory)
        # The folder must hold this run and no other before anything is said about its end.
        if differing := run_folder.differing_settings(earlier, config):
            raise OutputError(
                f"{directory} already holds a run with other settings "
                f"({', '.join(differing[:3])}{' …' if len(differing) > 3 else ''}); "
                "choose another folder"
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
    """
    directory = run_folder.find(run)
    with _held(directory):
        saved, before = run_folder.read(directory)
        config = with_overrides(before, dict(changes))
        if saved is not None and (state := saved.document.state) is not None:
            require_kept(before.train, config.train, state)
        check(config)
        return _continue(config, directory, reports, saved)


@contextlib.contextmanager
def _held(directory: Path) -> Iterator[None]:
    """Lock the directory; afterwards remove it if it is empty."""
    try:
        with hold(directory):
            yield
    finally:
        with contextlib.suppress(OSError):  # it holds files
            directory.rmdir()


def _begin(
    config: TrainConfig,
    directory: Path,
    reports: Reports,
    keep_more: Callable[[], None],
    stop: Callable[[], bool] = lambda: False,
) -> Finished:
    run_folder.check_free(directory)
    trainer = _trainer(config, directory)
    run_folder.keep_plugins(directory)
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
    # A new start would replace the policy of a run that has lost its last checkpoint.
    if saved is None and (directory / checkpoint.BEST).is_file():
        raise CheckpointError(
            f"{directory} lacks {checkpoint.LAST}, from which it would be resumed; its policy can "
            "be evaluated, and a new run can start from it (agent.start_from)"
        )
    trainer = _trainer(config, directory)
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


def _trainer(config: TrainConfig, directory: Path) -> Trainer:
    """Return a trainer whose directory has no leftovers and the folder of checkpoints."""
    run_folder.clear_leftovers(directory)
    trainer = Trainer(config, directory)
    make_folder(directory / checkpoint.BEST.parent)
    return trainer


def _train(
    trainer: Trainer, resume_at: int | None, reports: Reports, stop: Callable[[], bool]
) -> Finished:
    directory, config = trainer.directory, trainer.config
    total, done = config.train.decisions, trainer.progress.decision
    columns = list(config.rewards), config.randomise.names
    written = trainer.rows, trainer.companion.marked(trainer.rows)

    def metrics() -> MetricsCsv:
        opened = MetricsCsv(directory / METRICS, *columns, *written, reports.tell)
        trainer.companion.mark = opened.mark
        return opened

    # Listeners are opened one after the other; if one fails, those before it are closed.
    makers: list[Callable[[], Listener]] = [
        metrics,
        *openers(config, directory, resume_at, reports.warn),
        *(partial(make, total, done) for make in reports.listeners),
    ]
    if resume_at is None:  # else a kill leaves a metrics.csv that belongs to no run
        run_folder.write_config(directory, config, trainer.companion)
    with contextlib.ExitStack() as opened:  # the trainer closes them once it runs
        for make in makers:
            trainer.listeners.append(make())
            opened.push(closer(trainer.listeners[-1]))
        opened.pop_all()
    if resume_at is not None:  # once the files of a resumed run are read
        run_folder.write_config(directory, config, trainer.companion)
    # The summary is written even if the comparison after the training is interrupted.
    stopped_late: list[InterruptedRunError] = []
    try:
        with interrupts("finishing the episode and saving …") as interrupted:

            def stopped() -> bool:
                return interrupted() or stop()

            def regret() -> dict[str, Any] | None:
                try:
                    return reports.judge(config, directory, stopped, reports.tell)
                except InterruptedRunError as error:  # the summary is still to be written
                    stopped_late.append(error)
                    return None

            with naming_plugins():
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
    if stopped_late:
        raise stopped_late[0]
    return Finished(directory, summary, trained=True)
