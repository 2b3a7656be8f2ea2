"""Train a policy, as ``flipperctl train`` does; the result is a finished run."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flipperctl.cli.hydra.compose import compose_train, run_directory
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config import TrainConfig
from flipperctl.config.words import key_of
from flipperctl.errors import ConfigError, InterruptedRunError
from flipperctl.results import METRICS
from flipperctl.scripting.evaluating import data_frame
from flipperctl.scripting.policy import LoadedPolicy, load
from flipperctl.scripting.progress import training_reports
from flipperctl.scripting.settings import Paths, begin, check_training, short_errors, words
from flipperctl.session import interrupts
from flipperctl.terminal.training import check_resumed, print_best
from flipperctl.training.listeners import read_rows
from flipperctl.training.run import Finished, check, check_resumable, start
from flipperctl.training.run import resume as resume_run

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True)
class Run:
    """A training that is finished, and its files."""

    directory: Path
    """The run directory: configuration, checkpoints, metrics."""
    summary: Mapping[str, Any] = field(repr=False)
    """Contents of ``summary.json``: the best validation, and how long the training took."""

    def __fspath__(self) -> str:
        return str(self.directory)

    def metrics(self) -> list[dict[str, float | str | None]]:
        """Return the rows of ``metrics.csv``: one for each episode and each validation.

        ``kind`` is ``episode`` or ``validation``; a number that a row lacks is None.
        """
        rows = read_rows(self.directory / METRICS)
        return [{name: _value(cell) for name, cell in row.items()} for row in rows]

    def metrics_frame(self) -> DataFrame:
        """Return the rows of ``metrics.csv`` as a data frame of pandas.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return data_frame(self.metrics())

    def policy(self) -> LoadedPolicy:
        """Return the best policy of the run, ready to act.

        Raises:
            CheckpointError: its checkpoint was deleted or damaged.
        """
        return load(self.directory)


def _value(cell: str) -> float | str | None:
    """Return the number in a cell, None if it is empty, else its text."""
    if not cell:
        return None
    for number in (int, float):
        try:
            return number(cell)
        except ValueError:
            continue
    return cell


_FOLDER = "hydra.run.dir"


@short_errors()
def train(
    *,
    directory: str | os.PathLike[str] | None = None,
    resume: str | os.PathLike[str] | None = None,
    overrides: Sequence[str] = (),
    plugins: Paths = (),
    progress: bool = True,
    **settings: object,
) -> Run:
    """Train a policy to the end of its budget; return its run.

    ``settings`` are configuration keys: a name chooses (``terrain="stair"``,
    ``experiment="quick"``), a nested mapping (``train={"decisions": 20_000}``) or a dotted key
    (``**{"rewards.pitch.lambda_2": 8}``) sets fields, the settings of a plugin may be an object
    (``terrain=Ridge(height=0.3)``). ``overrides``: further ones as on the command line, such as
    ``"+reward@rewards.energy=energy"``. ``directory``: the run directory, which must hold no run;
    by default ``runs/<terrain>/<time>``. ``resume``: a run to resume where it stopped; of the
    settings, those of ``train``, ``device``, ``collector`` and ``logger`` alone can be given with
    it, but for some of ``train`` that hold for a whole run. ``plugins``: files or folders of
    plugins. ``progress``: whether progress is shown, on stderr or in the notebook.

    Raises:
        InterruptedRunError: the run was stopped by Ctrl-C or by the notebook's stop button;
            all is saved, and the text says how to resume it.
        OutputError: the directory already holds a run, or cannot be written.
        RequestError: a setting or plugin is wrong, or the training cannot begin (ConfigError,
            PluginError, TerrainError, CheckpointError, RunHeldError).
        FlipperctlError: the training failed, such as PluginFailedError.
    """
    begin(plugins)
    typed = words(settings, overrides)
    shown = training_reports(progress)
    if resume is not None:
        run = Path(resume)
        if directory is not None:
            raise ConfigError("directory: a resumed run stays in its own; leave it out")
        check_resumable(typed)
        changes = Overrides.parse(typed).values()
        finished = _interruptible(
            lambda: resume_run(run, changes, shown, check=check_resumed), [run], plugins
        )
    else:
        config, folder = _composed(typed, directory)
        unnamed = directory is None and _FOLDER not in map(key_of, typed)
        places = [folder]
        finished = _interruptible(
            lambda: start(config, folder, shown, keep_more=places.append, numbered=unnamed),
            *(places, plugins),
        )
    if progress:
        print_best(finished)
    return Run(finished.directory, finished.summary)


def _composed(
    typed: list[str], directory: str | os.PathLike[str] | None
) -> tuple[TrainConfig, Path]:
    """Return the checked configuration and the run directory."""
    folder = {} if directory is None else {_FOLDER: os.fspath(directory)}
    every = Overrides.parse([*typed, *words(folder)])
    for key in every.swept:
        raise ConfigError(f"{key}: several values make several runs; call train once for each")
    for key in every.where(lambda key: key.startswith("hydra") and key != _FOLDER).typed:
        raise ConfigError(f"{key}: a training from Python has no such setting")
    every.check_training(several=False)
    # pymunk would swallow a KeyboardInterrupt that is raised while it frees a body.
    with interrupts("stopping …") as stop:
        (config,) = compose_train(every.where(lambda key: key != _FOLDER))
        check_training(config)
        check(config)
    if stop():
        raise KeyboardInterrupt
    return config, run_directory(every).absolute()


def _interruptible(work: Callable[[], Finished], runs: list[Path], plugins: Paths) -> Finished:
    """Train; say in Python how a run that was stopped, the last of ``runs``, is resumed."""
    try:
        return work()
    except (KeyboardInterrupt, InterruptedRunError) as error:
        named = f", plugins={[os.fspath(path) for path in plugins]!r}" if plugins else ""
        call = f"flipperctl.train(resume={str(runs[-1])!r}{named})"
        # Ctrl-C is raised before or after the episodes, which end by themselves.
        interrupted = isinstance(error, KeyboardInterrupt)
        said = "interrupted. Resume with:" if interrupted else f"{error}, or in Python:"
        raise InterruptedRunError(f"{said} {call}") from error
