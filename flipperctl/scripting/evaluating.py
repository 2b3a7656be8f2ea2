"""Evaluate policies, as ``flipperctl eval`` does; the result has tables and data frames."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flipperctl.cli.plan import make_plan
from flipperctl.errors import FlipperctlError, MissingExtraError, RequestError
from flipperctl.evaluation import run as evaluation
from flipperctl.evaluation.evaluate import Interruption, PolicyError, Result
from flipperctl.evaluation.policies import Entrant, controllers, entrants
from flipperctl.evaluation.run import episode_rows
from flipperctl.evaluation.views import strata
from flipperctl.evaluation.views.evaluation import csv_rows, parse_columns, print_result
from flipperctl.evaluation.views.summary import Document, rate_text
from flipperctl.scripting import progress as shown
from flipperctl.scripting.policy import LoadedPolicy
from flipperctl.scripting.settings import Paths, begin, check_evaluation, short_errors, words

if TYPE_CHECKING:
    from pandas import DataFrame


def data_frame(rows: Iterable[Mapping[str, object]]) -> DataFrame:
    """Return a data frame with a row for each mapping; a column that a row lacks is empty there.

    Raises:
        MissingExtraError: pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise MissingExtraError(
            "data frames need pandas: pip install 'flipperctl[frames]'"
        ) from error
    return pandas.DataFrame(list(rows))


@dataclass(frozen=True, repr=False)
class Evaluation:
    """Policies on their scenes; SI units throughout."""

    result: Result
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
        found: list[Document] = self.document["scenes"]
        return found

    @property
    def interruption(self) -> Interruption | None:
        """How far the evaluation came before it was stopped; None if it was not."""
        return self.result.interruption

    @property
    def failures(self) -> tuple[PolicyError, ...]:
        """Policies that failed on a scene; their results are left out."""
        return self.result.failures

    def to_dict(self) -> dict[str, Any]:
        """Return plain data: what ``flipperctl eval --json`` prints."""
        return self.document

    def show(self, columns: Sequence[str] = ()) -> None:
        """Print the tables that ``flipperctl eval`` prints, with further ``columns``."""
        print_result(self.result, self.document, parse_columns(",".join(columns) or None))

    def scenes_frame(self) -> DataFrame:
        """Return a row for each scene and policy: means with their 95 % intervals.

        The columns are those of ``table.csv``, not rounded.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return data_frame(csv_rows(self.document))

    def episodes_frame(self) -> DataFrame:
        """Return a row for each episode of the policies and baselines, as in ``episodes.csv``.

        Raises:
            MissingExtraError: pandas is not installed.
        """
        return data_frame(episode_rows(self.result))


Named = str | os.PathLike[str] | LoadedPolicy


@short_errors()
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
    of a sweep, the name of a shipped policy or a controller, or what ``load`` returned; several in
    a list are compared on the same episodes. ``episodes`` per scene (100), ``seed`` of the episodes
    (0), processes (``jobs``, 1). ``baselines``: controllers that play the same episodes; None takes
    those of the policy, if it has any, and an empty list none. ``passable``: references that find
    out which episodes can be crossed. ``by``: drawn numbers to show results by, as in ``["steps",
    "slope+up"]``. ``output``: folder for tables and pictures; ``record``: file for the episodes, to
    teach from; ``film``: file for a ``.gif`` of the first episode. ``settings`` and ``overrides``
    are as in ``train`` and apply to the evaluation; several names are several scenes, as in
    ``terrain=["stair", "step"]``, and ``suite="robustness"`` chooses those of a suite. ``plugins``:
    files or folders of plugins. ``progress``: whether progress is shown, on stderr or in the
    notebook.

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
    given = [policy] if isinstance(policy, str | os.PathLike | LoadedPolicy) else list(policy)
    found: dict[Entrant, None] = {}
    own: dict[str, object] = {}
    for one in given:
        if isinstance(one, LoadedPolicy):
            file = one.source.checkpoint
            found[Entrant(one.name, file)] = None
            own |= {"controller": one.fields} if one.fields else {}
        else:
            found |= dict.fromkeys(entrants([os.fspath(one)], tell))
    suite = settings.pop("suite", None)
    if not isinstance(suite, str | os.PathLike | None):
        raise RequestError(f"suite: a name or a file is allowed; the value is {suite!r}")
    numbers = {"eval.episodes": episodes, "eval.seed": seed, "eval.jobs": jobs}
    chosen = settings | {key: number for key, number in numbers.items() if number is not None}
    plan = make_plan(
        [
            *([] if suite is None else [f"suite={os.fspath(suite)}"]),
            *words(own),
            *words(chosen, overrides),
        ],
        list(found),
        _names("baselines", baselines),
        tell,
    )
    for entry in plan.rows:
        check_evaluation(entry.config, entry.config.eval.jobs, entry.source.controller_name)
    done: list[Evaluation] = []

    def keep(result: Result, document: Document) -> None:
        done.append(Evaluation(result, document))

    try:
        evaluation.run(
            plan,
            references=controllers(_names("passable", passable or None), "passable"),
            by=strata.parse(_names("by", by or None), "by", [e.config for e in plan.rows]),
            outputs={
                name: None if file is None else Path(file)
                for name, file in (("folder", output), ("film", film), ("record", record))
            },
            show=keep,
            progress=show,
            tell=tell,
        )
    except FlipperctlError as error:
        error.result = done[0] if done else None
        raise
    return done[0]


def _names(argument: str, names: Sequence[str] | None) -> str | None:
    """Return names as the options of the command take them."""
    if isinstance(names, str):
        raise RequestError(f"{argument}: a list of names is allowed; the value is {names!r}")
    return None if names is None else ",".join(names) or "none"
