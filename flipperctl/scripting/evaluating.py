"""Evaluate a policy, as ``flipperctl eval`` does."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from flipperctl.cli.methods import MethodScenes, method_scenes
from flipperctl.cli.scenes import scenes
from flipperctl.errors import FlipperctlError, RequestError
from flipperctl.evaluation import scenes as evaluation
from flipperctl.evaluation.best_known import with_best_known
from flipperctl.evaluation.groups import grouped, parse
from flipperctl.policies.source import PolicySource
from flipperctl.runs.evaluation import EvaluationFiles
from flipperctl.runs.interrupts import interrupts
from flipperctl.runs.methods import entrants, standing
from flipperctl.runs.named_policies import controllers
from flipperctl.runs.suites import split_suite
from flipperctl.scripting import progress as shown
from flipperctl.scripting.beginning import Paths, begin, short_errors
from flipperctl.scripting.policy import LoadedPolicy, find
from flipperctl.scripting.result import Evaluation
from flipperctl.scripting.settings import words
from flipperctl.scripting.workers import check_evaluation


@short_errors()
def evaluate(
    policy: str | os.PathLike[str] | LoadedPolicy,
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
    """Evaluate a policy on scenes, with 95 % intervals; return the result.

    ``policy``: a run (``train`` returns one), a checkpoint, an exported ``.onnx`` file, the name of
    a shipped policy or a controller, or what ``load`` returned. ``episodes`` per scene (100),
    ``seed`` of the episodes (0), processes (``jobs``, 1). ``baselines``: controllers that play the
    same episodes; None takes those of the policy, if it has any, and an empty list none.
    ``passable``: references that find out which episodes can be crossed. ``by``: drawn numbers to
    show results by, as in ``["steps", "slope+up"]``. ``output``: folder for
    tables and pictures; ``record``: file for the episodes, to teach from; ``film``: file for a
    ``.gif`` of the first episode. ``settings`` and ``overrides`` are as in ``train`` and apply to
    the evaluation; several names are several scenes, as in ``terrain=["stair", "step"]`` or
    ``conditions=["nominal", "wide"]``. ``suite="robustness"`` plays the scenes of a suite, with the
    baselines as rows beside the policy, as ``eval suite=…`` does. ``plugins``: files or folders of
    plugins. ``progress``: whether progress is shown, on stderr or in the notebook.

    Raises:
        InterruptedRunError: the evaluation was stopped; ``output``, ``record`` and the error's
            ``result`` have the episodes that are finished.
        RequestError: the policy, a setting or a plugin is wrong, or a file cannot be written
            (CheckpointError, ConfigError, PluginError, PolicyError, OutputError).
        FlipperctlError: a policy or plugin failed, or a file could not be written; what was played
            is the error's ``result``, which lists the ``failures``.
    """
    begin(plugins)
    path, controller, own = _named(policy)
    numbers = {"eval.episodes": episodes, "eval.seed": seed, "eval.jobs": jobs}
    given = {key: number for key, number in numbers.items() if number is not None}
    chosen = _suite(settings.pop("suite", None))
    suite, arguments = split_suite([*chosen, *words(own), *words(settings | given, overrides)])
    against = _names("baselines", baselines)
    beside: list[PolicySource] = []
    if suite is not None:
        policies = entrants([] if path is None else [path], controller, shown.notes(progress))
        made = method_scenes(arguments, policies, standing(against, policies), suite)
    else:
        made = MethodScenes(scenes(arguments, path, controller), [])
        beside = controllers(against, "baselines", made.scenes[0][1].baselines())
    found = made.scenes
    for config, _ in found:
        check_evaluation(config, config.eval.jobs, controller)
    references = controllers(_names("passable", passable or None), "passable")
    groups = parse(_names("by", by or None), "by", [config for config, _ in found])
    show, tell = shown.episodes(progress), shown.notes(progress)
    files = {
        name: None if file is None else Path(file)
        for name, file in (("folder", output), ("film", film), ("record", record))
    }
    with ExitStack() as stack:
        written = EvaluationFiles(found, stack, **files, tell=tell)
        stop = stack.enter_context(interrupts("finishing the episode; Ctrl-C again stops at once"))
        result = evaluation.evaluate(
            found,
            baselines=beside,
            references=references,
            progress=show,
            record=record is not None,
            stop=stop,
            store=written.store,
            names=made.names,
        )
        if suite is not None and against != "none":
            result = with_best_known(result, found, written.store)
        result = grouped(result, groups)
        evaluated = Evaluation(result.scenes, result.interruption, result.failures)
        try:
            written.write(result)
            written.draw(result, stop, show)
        except FlipperctlError as error:
            error.result = evaluated
            raise
    return evaluated


def _named(
    policy: str | os.PathLike[str] | LoadedPolicy,
) -> tuple[Path | None, str | None, dict[str, object]]:
    """Return the file of a policy, or its controller, and the settings that were given for it."""
    if not isinstance(policy, LoadedPolicy):
        return *find(policy), {}
    own: dict[str, object] = {"controller": policy.fields} if policy.fields else {}
    if policy.source.checkpoint is not None:
        return policy.source.checkpoint, None, own
    return None, policy.name, own


def _suite(name: object) -> list[str]:
    """Return the word that chooses a suite by its name or file; none for None."""
    if name is None:
        return []
    if not isinstance(name, str | os.PathLike):
        raise RequestError(f"suite: a name or a file is allowed; the value is {name!r}")
    return [f"suite={os.fspath(name)}"]


def _names(argument: str, names: Sequence[str] | None) -> str | None:
    """Return names as the options of the command take them."""
    if isinstance(names, str):
        raise RequestError(f"{argument}: a list of names is allowed; the value is {names!r}")
    return None if names is None else ",".join(names) or "none"
