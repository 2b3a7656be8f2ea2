"""The Python interface: train and evaluate policies, as the commands do.

In: overrides as on the command line, or keyword arguments. Out: a ``Run``, an ``Evaluation``.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flipperctl.checkpoint.results import METRICS
from flipperctl.config import EnvConfig, TrainConfig
from flipperctl.env.metrics import RENAMED
from flipperctl.errors import (
    ConfigError,
    FlipperctlError,
    InterruptedRunError,
    RequestError,
    missing_extra,
)
from flipperctl.evaluation import evaluate as results
from flipperctl.evaluation.plan import NamedPolicy, controllers, entrants
from flipperctl.process.session import interrupts
from flipperctl.requests import drawing, evaluation
from flipperctl.requests.compose import compose_train, run_directory
from flipperctl.requests.evaluation import episode_rows
from flipperctl.requests.filming import Filming
from flipperctl.requests.plan import make_plan
from flipperctl.requests.request import RUN_FOLDER, Request, Requests, from_values
from flipperctl.scripting import progress as shown
from flipperctl.scripting.policy import Function, LoadedPolicy, function_policy, load
from flipperctl.scripting.settings import (
    Paths,
    begin,
    check_evaluation,
    check_training,
    public,
    requested,
)
from flipperctl.terminal.streams import print_note
from flipperctl.terminal.training import check_resumed, print_best
from flipperctl.text.files import read_csv
from flipperctl.training.run import Finished, check, check_resumable, start
from flipperctl.training.run import resume as resume_run
from flipperctl.views.evaluation import (
    csv_rows,
    parse_columns,
    parse_groups,
    print_result,
)
from flipperctl.views.summary import Document, rate_text

if TYPE_CHECKING:
    import numpy as np
    from gymnasium import Env
    from matplotlib.figure import Figure
    from numpy.typing import NDArray
    from pandas import DataFrame


def data_frame(rows: Iterable[Mapping[str, object]]) -> DataFrame:
    """Return a data frame with a row for each mapping; a column that a row lacks is empty there.

    Raises:
        MissingExtraError: pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise missing_extra("a data frame", "pandas") from error
    return pandas.DataFrame(list(rows))


@dataclass(frozen=True)
class Run:
    """A training that is finished, and its files."""

    directory: Path
    """The run directory: configuration, checkpoints, metrics."""
    summary: Mapping[str, Any] = field(repr=False)
    """Contents of ``summary.json``: the best validation, and how long the training took."""

    def __fspath__(self) -> str:
        return str(self.directory)

    @public
    def metrics(self) -> list[dict[str, float | str | None]]:
        """Return the rows of ``metrics.csv``: one for each episode and each validation.

        ``kind`` is ``episode`` or ``validation``; a number that a row lacks is None.
        """
        rows = read_csv(self.directory / METRICS, (), RENAMED)
        return [{name: _value(cell) for name, cell in row.items()} for row in rows]

    @public
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


_OF_TRAINING = {*TrainConfig.model_fields, "hydra"} - {*EnvConfig.model_fields, "actions", "seed"}
FLIPPER = "flipperctl.env:flipperctl/Flipper-v0"
"""The environment, for ``gymnasium.make``."""


@public
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

    ``settings`` are configuration keys. A name chooses (``terrain="stair"``,
    ``experiment="quick"``), a nested mapping (``train={"decisions": 20_000}``) or a dotted key
    (``**{"rewards.swing.weight": 4}``) sets fields. The settings of a plugin may be an object
    (``terrain=Ridge(height=0.3)``). ``overrides``: further ones as on the command line, such as
    ``"rewards.energy=energy"``. ``directory``: the run directory, which must hold no run;
    by default ``runs/<terrain>/<time>``. ``resume``: a run to resume where it stopped. With it,
    only settings of ``train``, ``device``, ``collector`` and ``logger`` are allowed, and none of
    ``train`` that hold for a whole run. ``plugins``: files or folders of
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
    requests = requested(settings, overrides)
    reports = shown.training_reports(progress)
    if resume is not None:
        run = Path(resume)
        if directory is not None:
            raise ConfigError("directory: a resumed run stays in its own; leave it out")
        check_resumable(request.text for request in requests)
        changes = requests.values()
        finished = _interruptible(
            lambda: resume_run(run, changes, reports, check=check_resumed), [run], plugins
        )
    else:
        # A folder that is named by the time gets a number where two begin in one second.
        config, folder = _composed(requests, directory)
        unnamed = directory is None and RUN_FOLDER not in requests.typed
        places = [folder]
        finished = _interruptible(
            lambda: start(config, folder, reports, keep_more=places.append, numbered=unnamed),
            places,
            plugins,
        )
    if progress:
        print_best(finished)
    return Run(finished.directory, finished.summary)


@public
def environment(
    *,
    render_mode: str | None = None,
    overrides: Sequence[str] = (),
    plugins: Paths = (),
    **settings: object,
) -> Env[NDArray[np.float32], Any]:
    """Return the environment in which ``train`` would train, for a method of your own.

    ``settings``, ``overrides`` and ``plugins`` are as in ``train``, presets included
    (``rewards="paper"``); settings of the training and its learner are refused. ``seed`` is for
    the first ``reset``. ``actions="rates"`` has continuous actions, ``Box(-1, 1, (2,))``.
    ``render_mode``: None, ``"rgb_array"``, or ``"human"`` for Gymnasium's window, which needs
    pygame.

    Raises:
        RequestError: a setting or plugin is wrong (ConfigError, PluginError).
    """
    import gymnasium

    begin(plugins)
    requests = requested(settings, overrides)
    for key in requests.swept:
        raise ConfigError(f"{key}: several values make several environments; one is allowed")
    for key in requests.typed:
        if (section := key.split(".")[0]) in _OF_TRAINING:
            raise ConfigError(f"{key}: {section} belongs to a training, and has no meaning here")
    (config,) = compose_train(requests)
    options: dict[str, Any] = {"config": config.environment(), "actions": config.actions}
    if "seed" in requests.typed:
        options["seed"] = config.seed
    return gymnasium.make(FLIPPER, **options, render_mode=render_mode)


def _composed(
    requests: Requests, directory: str | os.PathLike[str] | None
) -> tuple[TrainConfig, Path]:
    """Return the checked configuration and the run directory."""
    if directory is not None:
        requests = Requests.of(requests, [Request(RUN_FOLDER, os.fspath(directory))])
    for key in requests.swept:
        raise ConfigError(f"{key}: several values make several runs; call train once for each")
    for key in requests.where(lambda key: key.startswith("hydra") and key != RUN_FOLDER).typed:
        raise ConfigError(f"{key}: a training from Python has no such setting")
    requests.check_training(several=False)
    # pymunk would swallow a KeyboardInterrupt that is raised while it frees a body.
    with interrupts("stopping …") as stop:
        (config,) = compose_train(requests.where(lambda key: key != RUN_FOLDER))
        check_training(config)
        check(config)
    if stop():
        raise KeyboardInterrupt
    folder = run_directory(requests) if directory is None else Path(directory)
    return config, folder.absolute()


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


@dataclass(frozen=True, repr=False)
class Evaluation:
    """Policies on their scenes; SI units throughout."""

    result: results.Result
    """The plan and the episodes."""
    document: Document = field(compare=False)
    """Plain data: what ``flipperctl eval --json`` prints."""

    def __repr__(self) -> str:
        scenes = ", ".join(
            f"{s['terrain']}: success {rate_text(s['success'])}" for s in self.scenes
        )
        return f"Evaluation({self.document['controller']}; {scenes})"

    @property
    def scenes(self) -> list[Document]:
        """The results on each scene, as plain data (see ``to_dict``)."""
        scenes: list[Document] = self.document["scenes"]
        return scenes

    @property
    def interruption(self) -> results.Interruption | None:
        """How far the evaluation came before it was stopped; None if it was not."""
        return self.result.interruption

    @property
    def failures(self) -> tuple[results.PolicyError, ...]:
        """Policies that failed on a scene; their results are left out."""
        return self.result.failures

    def to_dict(self) -> dict[str, Any]:
        """Return plain data: what ``flipperctl eval --json`` prints."""
        return self.document

    @public
    def show(self, columns: Sequence[str] = ()) -> None:
        """Print the tables that ``flipperctl eval`` prints, with further ``columns``."""
        print_result(self.result, self.document, parse_columns(",".join(columns) or None))

    @public
    def scenes_frame(self) -> DataFrame:
        """Return a row for each scene and policy: means with their 95 % intervals.

        The columns are as in ``table.csv``, not rounded.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return data_frame(csv_rows(self.document))

    @public
    def episodes_frame(self) -> DataFrame:
        """Return a row for each episode of the policies and baselines, as in ``episodes.csv``.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return data_frame(episode_rows(self.result))


Named = str | os.PathLike[str] | LoadedPolicy | Function


@public
def evaluate(
    policy: Named | Sequence[Named],
    *,
    episodes: int | None = None,
    seed: int | None = None,
    jobs: int | None = None,
    baselines: Sequence[str] | None = None,
    passable: Sequence[str] = (),
    by: Sequence[str] = (),
    output: str | os.PathLike[str] | None = None,
    record: str | os.PathLike[str] | None = None,
    film: str | os.PathLike[str] | None = None,
    overrides: Sequence[str] = (),
    plugins: Paths = (),
    progress: bool = True,
    **settings: object,
) -> Evaluation:
    """Evaluate one or several policies on scenes, with 95 % intervals; return the result.

    ``policy``: a run (``train`` returns one), a checkpoint, an exported ``.onnx`` file, the folder
    of a sweep, the name of a shipped policy or a controller, what ``load`` returned, or a function
    from an observation, (n,) in SI units, to an action, which results call by its name. Several in
    a list are compared on the same episodes. ``episodes`` per scene (100), ``seed`` of the episodes
    (0), processes (``jobs``, 1). ``baselines``: controllers that play the same episodes; None takes
    those of the policy, if it has any, and an empty list none. ``passable``: references that find
    out which episodes can be crossed, controllers or the policies themselves. ``by``: drawn numbers
    to show results by, as in ``["steps", "slope+up"]``. ``output``: folder for tables and pictures;
    ``record``: file for the episodes, to teach from; ``film``: file for a ``.gif`` of the first
    episode. ``settings`` and ``overrides`` are as in ``train`` and apply to the evaluation; several
    names are several scenes, as in ``terrain=["stair", "step"]``, and ``suite="robustness"``
    chooses those of a suite. ``plugins``: files or folders of plugins. ``progress``: whether
    progress is shown, on stderr or in the notebook.

    Raises:
        InterruptedRunError: the evaluation was stopped; ``output``, ``record`` and the error's
            ``result`` have the episodes that are finished.
        RequestError: the policy, a setting or a plugin is wrong, or a file cannot be written
            (CheckpointError, ConfigError, PluginError, PolicyError, OutputError).
        FlipperctlError: a policy or plugin failed, or a file could not be written; what was played
            is the error's ``result``, which lists the ``failures``.
    """
    begin(plugins)
    show, tell = shown.episodes(progress), shown.notes(progress)
    if isinstance(policy, str) or not isinstance(policy, Sequence):
        policy = [policy]
    # Functions and loaded policies become entrants as names and paths do.
    methods: dict[NamedPolicy, None] = {}
    controller_fields: dict[str, object] = {}
    for item in policy:
        if isinstance(item, LoadedPolicy):
            file = item.source.checkpoint
            methods[NamedPolicy(item.name, file)] = None
            controller_fields |= {"controller": item.fields} if item.fields else {}
        elif callable(item):
            named = NamedPolicy(function_policy(item))
            if named in methods:
                raise RequestError(
                    f"policy: two functions are called {named.method!r}; give each a name by def"
                )
            methods[named] = None
        elif not isinstance(item, str | os.PathLike):
            raise RequestError(
                "policy: a name, a path, a loaded policy or a function is allowed, not a "
                f"{type(item).__name__}; docs/own_method.md makes a function of any model"
            )
        else:
            methods |= dict.fromkeys(entrants([os.fspath(item)], tell))

    # The same requests as from a command line
    suite = settings.get("suite")
    if not isinstance(suite, str | os.PathLike | None):
        raise RequestError(f"suite: a name or a file is allowed; the value is {suite!r}")
    numbers = {"eval.episodes": episodes, "eval.seed": seed, "eval.jobs": jobs}
    keys = settings | {key: number for key, number in numbers.items() if number is not None}
    requests = Requests.of(from_values(controller_fields), requested(keys, overrides))
    plan = make_plan(requests, list(methods), _names("baselines", baselines), tell)
    for entry in plan.rows:
        check_evaluation(entry.config, entry.config.eval.jobs, entry.source.controller_name)
    files = {"folder": output, "record": record}

    # An error has the result of what was played before it.
    done: list[Evaluation] = []

    def keep(result: results.Result, document: Document) -> None:
        done.append(Evaluation(result, document))

    try:
        evaluation.run(
            plan,
            references=controllers(
                _names("passable", passable or None),
                "passable",
                planned=[entry.source for entry in plan.entries],
            ),
            by=parse_groups(_names("by", by or None), "by", [e.config for e in plan.rows]),
            outputs={name: None if file is None else Path(file) for name, file in files.items()},
            filming=None if film is None else Filming(Path(film)),
            show=keep,
            progress=show,
            tell=tell,
        )
    except FlipperctlError as error:
        error.result = done[0] if done else None
        raise
    return done[0]


@public
def plot(
    *sources: str | os.PathLike[str],
    kind: str | None = None,
    names: Mapping[str, str] | None = None,
    metrics: Sequence[str] = (),
    only: Sequence[str] = (),
    scene: str | None = None,
    episode: int | None = None,
    against: str | None = None,
    average: str = "mean",
    width: str | None = None,
    style: str = "paper",
    plugins: Paths = (),
) -> Figure:
    """Return a figure of runs, a sweep, or folders of results or of a map.

    The arguments are as of ``flipperctl plot``; ``names``: methods by the names that they get,
    as in ``{"AT-D3QN": "runs/first"}``. What the figure leaves out is printed on stderr.

    Raises:
        RequestError: there is nothing to draw, or an argument does not fit.
    """
    from flipperctl.views.plot import Request

    begin(plugins)
    request = Request(
        [os.fspath(source) for source in sources],
        metrics=metrics,
        names=[f"{name}={method}" for name, method in (names or {}).items()],
        only=only,
        against=against,
        scene=scene,
        episode=episode,
        width=None if width is None else drawing.length(width),
    )
    return drawing.draw(request, kind=kind, average=average, style=style, tell=print_note).figure


def _names(argument: str, names: Sequence[str] | None) -> str | None:
    """Return names as the options of the command take them."""
    if isinstance(names, str):
        raise RequestError(f"{argument}: a list of names is allowed; the value is {names!r}")
    return None if names is None else ",".join(names) or "none"
