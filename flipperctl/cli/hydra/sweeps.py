"""Sweeps, whose jobs are the combinations of lists, and searches, whose trials Optuna proposes.

In: overrides, some of them lists, ``interval(…)`` or ``tag(log,interval(…))``. Out: a run directory
for each combination or trial, named after it, and a table that compares the runs. Any launcher of
Hydra can train them. Ray's launcher (hydra-ray-launcher 1.2) cannot join a running cluster by
itself: it requests an object store of its own size, which Ray refuses then. It uses an existing
connection.
"""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import mean
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn
from hydra.plugins.launcher import Launcher
from omegaconf import DictConfig, OmegaConf, read_write

from flipperctl.config.words import literal_override
from flipperctl.errors import ConfigError, InterruptedRunError
from flipperctl.process.session import quote_path
from flipperctl.requests.compose import compose_train
from flipperctl.requests.request import Requests, Several
from flipperctl.requests.text import from_words, read
from flipperctl.rollout.cluster import is_connected, join
from flipperctl.terminal.progress import HEADING
from flipperctl.terminal.streams import print_note
from flipperctl.text.messages import counted, percent
from flipperctl.text.show import NONE, Column, Table, console, print_lines, print_table
from flipperctl.training.search import Interval, SearchSettings, check_settings, search
from flipperctl.training.sweep import FILE, Job, JobResult, Sweep, SweepRun

_OBJECT_STORE = 75 * 2**20
"""Memory for objects of a cluster of the launcher's own, which is its default [B]."""
_MODULE = "hydra_plugins.hydra_ray_launcher.ray_launcher"
_SWEEPERS = "hydra_plugins.flipperctl_sweepers"
_ROWS = 40
"""Largest number of rows of the table; the file holds all runs."""
_COLUMNS = (
    Column("success", "success"),
    Column("variation", HEADING),
    Column("t_cost", "time [s]", 1),
    Column("runs", "runs", named=True),
)


def register_sweepers() -> None:
    """Register ``hydra/sweeper=optuna``, and our sweeper over lists as ``hydra/sweeper=basic``.

    Hydra discovers the classes themselves (see ``hydra_plugins``). Their names are registered here,
    for this process alone; other Hydra applications keep their own ``basic`` and ``optuna``.
    """
    Plugins.instance()  # the discovery registers Hydra's own entries, which ours replace
    settings: dict[str, dict[str, Any]] = {
        "basic": {"_target_": f"{_SWEEPERS}.ListSweeper", "max_batch_size": None, "params": None},
        "optuna": {"_target_": f"{_SWEEPERS}.OptunaSweeper", **SearchSettings().model_dump()},
    }
    for name, node in settings.items():
        ConfigStore.instance().store(group="hydra/sweeper", name=name, node=node)


def connect(launcher: Launcher) -> None:
    """Connect to the cluster of a Ray launcher; do nothing for other launchers.

    Without an address, Ray joins the cluster that ``ray start`` has started on this machine, or
    starts one; at the address ``local``, it always starts one.
    """
    module = sys.modules.get(_MODULE)
    if module is None or not isinstance(launcher, module.RayLauncher) or is_connected():
        return
    ray: Any = launcher
    settings: Any = OmegaConf.to_container(ray.ray_cfg.init, resolve=True)
    address = settings.pop("address", None)
    if address == "local":
        settings.setdefault("object_store_memory", _OBJECT_STORE)
    join(address, "hydra.launcher.ray.init.address", **settings)


_TASK = {"terrain", "conditions", "sim", "perception", "episode", "robot", "randomise"}
"""Sections and groups that change what validations are made of."""
_EXPERIMENT = "experiment"
UNNAMED = "${hydra.job.num}_${terrain.name}_seed${seed}"
"""``hydra.sweep.subdir`` of train.yaml, which is replaced by the names of the swept values."""


def named_by_time(config: DictConfig, mode: str) -> bool:
    """Return whether the folder of ``hydra.run`` or ``hydra.sweep`` is named by the time."""
    settings: Any = OmegaConf.to_container(config.hydra[mode], resolve=False)
    return "${now:" in str(settings["dir"])


def launched_by(launcher: Launcher, config: DictConfig) -> Sweep:
    """Return a sweep in Hydra's folder, whose jobs are trained by a launcher of Hydra.

    If the folder is named by the time, and another sweep of the same second is in it, another one
    beside it is taken.
    """

    def launch(jobs: Sequence[Job], names: Sequence[str], first: int) -> list[JobResult]:
        # A worker of a running cluster has another working directory.
        place = literal_override("hydra.sweep.dir", str(sweep.folder.absolute()))
        words = [[*job, place] for job in jobs]
        for job, name in zip(words, names, strict=False):
            job.append(f"hydra.sweep.subdir='{name}'")
        connect(launcher)
        return [job_result(job) for job in launcher.launch(words, initial_job_idx=first)]

    unresolved: Any = OmegaConf.to_container(config.hydra.sweep, resolve=False)
    sweep = Sweep(
        Path(str(config.hydra.sweep.dir)),
        launch,
        print_comparison,
        named=bool(unresolved["subdir"] == UNNAMED),
        # Hydra's basic launcher runs the jobs in sequence and would continue after Ctrl-C.
        serial=OmegaConf.select(config, "hydra.runtime.choices.hydra/launcher") == "basic",
        numbered=named_by_time(config, "sweep"),
        words=sys.argv[1:],  # as the application set them for Hydra
        tell=print_note,
    )
    return sweep


def job_result(job: JobReturn) -> JobResult:
    """Return the value of a job, or the error that ended it.

    ``return_value`` writes a line to stderr before it raises the error. That line is hidden,
    since the command shows the error itself.
    """
    composed: Any = job.hydra_cfg
    folder = Path(composed.hydra.runtime.output_dir)
    with contextlib.redirect_stderr(io.StringIO()):
        try:
            return JobResult(folder, job.return_value, None)
        except Exception as error:  # noqa: BLE001 (a job may fail in any way)
            return JobResult(folder, None, error)


def list_sweep(settings: Mapping[str, Any], **arguments: Any) -> Callable[[list[str]], None]:
    """Return a sweep over lists, with named folders and a table at the end.

    ``settings`` are as of Hydra's basic sweeper, and ``arguments`` what its ``setup`` takes. The
    returned function trains every combination, or continues what an earlier start in the same
    folder began.
    """
    config = arguments["config"]
    jobs = launched_by(Plugins.instance().instantiate_launcher(**arguments), config)

    def run(arguments: list[str]) -> None:
        # Every combination of the words, and of the sweeper's own parameters
        params = settings["params"] or {}
        words = [*(f"{key}={value}" for key, value in params.items()), *arguments]
        requests = Requests(tuple(read(words)))
        jobs.swept = requests.swept
        if intervals := [r.name for r in requests if isinstance(r.value, Interval)]:
            raise ConfigError(f"{intervals[0]}: an interval is searched by hydra/sweeper=optuna")
        combinations = [combination.words for combination in requests.combinations()]

        # One process trains a sweep's folder at a time.
        with jobs.held():
            with read_write(config.hydra.sweep):
                config.hydra.sweep.dir = str(jobs.folder)
            OmegaConf.save(config, jobs.folder / "multirun.yaml")
            try:
                size = settings["max_batch_size"] or len(combinations)
                for first in range(0, len(combinations), size):
                    jobs.launch(combinations[first : first + size], first)
                    jobs.raise_errors()
            except (InterruptedRunError, KeyboardInterrupt) as error:
                done = sum(run.state == "finished" for run in jobs.runs)
                raise InterruptedRunError(
                    f"interrupted; {done} of {jobs.jobs} runs are finished. "
                    f"Continue with: {jobs.command()}"
                ) from error

    return run


def _row(group: Sequence[SweepRun]) -> dict[str, Any]:
    """Return the means over the best validations of runs, with the range of pitch variations."""
    rows = [run.row() for run in group]
    rates, variations, times = (
        [row[name] for row in rows if row[name] is not None]
        for name in ("success_rate", "pitch_variation_100hz", "t_cost")
    )
    some = [f"{len(variations)} of {len(group)} runs"] if len(variations) < len(group) else []
    ends = [f"{min(variations):.2f} to {max(variations):.2f}"] if len(variations) > 1 else []
    text = f" ({', '.join(ends + some)})" if ends or some else ""
    states = dict.fromkeys(run.state for run in group if run.state != "finished")
    named = group[0].folder.name if len(group) == 1 else counted(len(group), "run")
    return {
        "success": percent(mean(rates)) if rates else NONE,
        "variation": f"{mean(variations):.2f}{text}" if variations else NONE,
        "is_noted": bool(variations and text),
        "t_cost": mean(times) if times else None,
        "runs": named + (f" ({', '.join(states)})" if states else ""),
    }


def print_comparison(folder: Path, runs: Sequence[SweepRun]) -> None:
    """Print a row for each run of the sweep in ``folder``, and the path of the file.

    Runs that differ in their seeds alone are one row. Print nothing without runs.
    """
    if not runs:
        return
    # Runs by all swept values but the seed
    keys = list(dict.fromkeys(key for run in runs for key in run.swept))
    methods: dict[tuple[str, ...], list[SweepRun]] = {}
    for run in runs:
        values = [run.swept.get(key, "") for key in keys if key != "seed"]
        methods.setdefault(tuple(values), []).append(run)
    if pooled := len(methods) < len(runs):
        keys = [key for key in keys if key != "seed"]

    # As many rows as a terminal shows well
    columns = [*(Column(f"swept {key}", key, named=True) for key in keys), *_COLUMNS]
    shown = [*methods.values()] if pooled else [[run] for run in runs]
    rows = [
        {f"swept {key}": group[0].swept.get(key, "") for key in keys} | _row(group)
        for group in shown[:_ROWS]
    ]
    out = console(stderr=True)
    print_table(Table(columns, rows, f"{quote_path(folder)}: {counted(len(runs), 'run')}"), out)
    left = len(shown) - _ROWS
    more = f"{counted(left, 'more row')} and the table" if left > 0 else "the table"
    text = f"{more}: {quote_path(folder / FILE)}"
    noted = any(row["is_noted"] for row in rows)
    notes = ["In parentheses: the least and the largest, and how many runs reached the finish."]
    print_lines(out, [*notes * noted, text])


def search_sweep(settings: Mapping[str, Any], **arguments: Any) -> Callable[[list[str]], None]:
    """Return a search whose trials are jobs of Hydra: ``hydra/sweeper=optuna``.

    ``settings`` are the section ``hydra.sweeper``; ``arguments`` are what its ``setup`` takes.
    Hydra's own plugin, hydra-optuna-sweeper 1.3, needs Optuna 2, whose storage fails with
    SQLAlchemy 2, and repeats every trial after a restart.
    """
    checked = check_settings(settings)
    jobs = launched_by(Plugins.instance().instantiate_launcher(**arguments), arguments["config"])

    def run(arguments: list[str]) -> None:
        swept, fixed = sampled(Requests(tuple(read(arguments))))
        check_objective(swept, fixed)
        if tasks := [key for key in swept if _setting(key).split(".")[0] in _TASK]:
            print_note(
                f"note: {', '.join(tasks)} change what a training is judged on; the best trial may "
                "be the easiest"
            )
        search(checked, jobs, arguments, swept, fixed, tell=print_note)

    return run


def sampled(requests: Requests) -> tuple[dict[str, Interval | Sequence[str]], list[str]]:
    """Return the intervals and lists that a search samples, by key, and the other words."""
    values: dict[str, Interval | Sequence[str]] = {}
    fixed: list[str] = []
    for request in requests:
        if isinstance(request.value, Several):
            values[request.name] = [r.text.partition("=")[2] for r in request.value.requests]
        elif isinstance(request.value, Interval):
            values[request.name] = request.value
        else:
            fixed.append(request.text)
    return values, fixed


def check_objective(sampled: Mapping[str, Interval | Sequence[str]], fixed: Sequence[str]) -> None:
    """Refuse a search whose trials have objectives that cannot be compared."""
    for key in sampled:
        setting = _setting(key)
        if setting == "train.best_by" or setting.startswith("train.validation_"):
            raise ConfigError(f"{key}: a search has one objective; one value is allowed")

    # Trials may differ in rewards only if success judges them.
    paying = [key for key in sampled if _setting(key).split(".")[0] == "rewards"]
    words = [word for word in fixed if not (paying and _setting(word).startswith("rewards."))]
    lists = {key: values for key, values in sampled.items() if not isinstance(values, Interval)}
    # Of the lists, an experiment alone changes the objective; of others, the first value stands.
    first = [f"{key}={values[0]}" for key, values in lists.items() if key != _EXPERIMENT]
    objectives: dict[bool, str] = {}
    for experiment in lists.get(_EXPERIMENT, [None]):
        choice = [] if experiment is None else [f"{_EXPERIMENT}={experiment}"]
        for config in compose_train(from_words([*words, *first, *choice])):
            objectives.setdefault(config.train.best_by == "return", " ".join(choice))
    if paying and True in objectives:
        raise ConfigError(
            f"{paying[0]}: a search by returns (train.best_by=return) would find the rewards that "
            "pay most, not those that teach best; search with train.best_by=success"
        )
    if len(objectives) > 1:
        *_, other = objectives.values()
        raise ConfigError(
            f"{other}: a search has one objective, but this changes train.best_by; give that a "
            "value of its own"
        )


def _setting(word: str) -> str:
    """Return the setting of an override or its key, as in ``+reward@rewards.blow=impact``."""
    return word.partition("=")[0].lstrip("+~").rpartition("@")[2]
