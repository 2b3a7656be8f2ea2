"""Evaluate a policy on scenes, together with baselines and references.

In: a configuration and a policy's source for each scene. Out: an ``EvaluationResult`` for
the command line, reports and other programs; nothing is printed or written here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace

from flipperctl.config import EvalConfig
from flipperctl.errors import InterruptedRunError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.episodes import play_episodes
from flipperctl.evaluation.results import (
    BaselineResult,
    EvaluationResult,
    Interruption,
    SceneResult,
)
from flipperctl.evaluation.statistics import differences, summarise
from flipperctl.evaluation.workers import EpisodeWorkers
from flipperctl.policies.source import PolicySource

Scene = tuple[EvalConfig, PolicySource]
"""``config.eval`` holds the number of episodes and the seed."""
Progress = Callable[[str, int], AbstractContextManager[Callable[[float], None]]]
"""Opens the progress of some episodes, from a label and their number. The context manager yields a
function of the number of finished episodes; a search counts as a fraction of its episode."""


@contextmanager
def no_progress(label: str, episodes: int) -> Iterator[Callable[[float], None]]:
    """Show nothing."""
    yield lambda done: None


def evaluate(
    scenes: Sequence[Scene],
    *,
    baselines: Sequence[PolicySource] = (),
    references: Sequence[PolicySource] = (),
    progress: Progress = no_progress,
    record: bool = False,
    stop: Callable[[], bool] = lambda: False,
) -> EvaluationResult:
    """Evaluate one policy on each scene, with as many processes as the first one asks for.

    ``baselines`` play the same episodes for comparison. ``references`` try in turn the episodes
    that the policy did not cross, to find out which can be crossed at all. ``record``: whether the
    policy's results hold its decisions. Once ``stop``, called before each episode, returns True,
    the evaluation ends with what is finished.

    Raises:
        FlipperctlError: a policy cannot be built or failed, or an episode killed its workers.
        InterruptedRunError: it was stopped before an episode was finished.
        ValueError: there are no scenes.
    """
    if not scenes:
        raise ValueError("an evaluation needs at least one scene")
    with EpisodeWorkers(scenes[0][0].eval.jobs, stop) as workers:
        results = [
            _evaluate_scene(c, s, baselines, references, workers, progress, record)
            for c, s in scenes
        ]
    interruption = None
    if workers.interrupted:
        interruption = _interruption([config for config, _ in scenes], results, 1 + len(baselines))
    finished = tuple(result for result in results if result is not None)
    return EvaluationResult(scenes[0][1].label(), finished, interruption)


def _interruption(
    configs: Sequence[EvalConfig], results: Sequence[SceneResult | None], players: int
) -> Interruption:
    """Return what is finished of the episodes of the policy and its baselines."""
    planned = players * sum(config.eval.episodes for config in configs)
    finished = sum(result.finished for result in results if result is not None)
    if not finished:
        raise InterruptedRunError(f"interrupted: none of {planned} episodes is finished")
    pairs = zip(configs, results, strict=True)
    missing = [config.terrain.plugin_name for config, result in pairs if result is None]
    return Interruption(finished, planned, tuple(missing))


def _evaluate_scene(
    config: EvalConfig,
    source: PolicySource,
    baselines: Sequence[PolicySource],
    references: Sequence[PolicySource],
    workers: EpisodeWorkers,
    progress: Progress,
    record: bool,
) -> SceneResult | None:
    """Return the result of a scene; None if it was stopped before an episode was finished."""
    terrain = config.terrain.plugin_name
    episodes = play_scene(config, source, terrain, workers, progress, record=record)
    if not episodes:
        return None
    if references:
        episodes = _crossed_by_references(config, source, references, episodes, workers, progress)
    others = []
    for baseline in baselines:
        label = baseline.label()
        if played := play_scene(config, baseline, f"{terrain}, {label}", workers, progress):
            others.append(compare(terrain, episodes, label, played))
    return SceneResult(
        summarise(terrain, episodes),
        config.eval.seed,
        Conditions.of(config),
        tuple(others),
        tuple(episodes),
    )


def compare(
    terrain: str, ours: Sequence[EpisodeResult], label: str, theirs: Sequence[EpisodeResult]
) -> BaselineResult:
    """Return the summary of a baseline's episodes, and how ours differ from them.

    Raises:
        ValueError: there are none.
    """
    return BaselineResult(
        label, summarise(terrain, theirs), differences(ours, theirs), tuple(theirs)
    )


def _crossed_by_references(
    config: EvalConfig,
    source: PolicySource,
    references: Sequence[PolicySource],
    episodes: Sequence[EpisodeResult],
    workers: EpisodeWorkers,
    progress: Progress,
) -> list[EpisodeResult]:
    """Return the episodes with ``crossed_by`` set: the policy's label, a reference's, or empty.

    It stays unset if the references were stopped: an episode that none has tried tells nothing.
    """
    crossed_by = {e.episode: source.label() if e.reached else "" for e in episodes}
    for reference in references:
        left = [index for index, label in crossed_by.items() if not label]
        label = f"{config.terrain.plugin_name}, {reference.label()} on what was not crossed"
        for result in play_scene(config, reference, label, workers, progress, left):
            if result.reached:
                crossed_by[result.episode] = reference.label()
    if workers.interrupted:
        return list(episodes)
    return [replace(e, crossed_by=crossed_by[e.episode]) for e in episodes]


def play_scene(
    config: EvalConfig,
    source: PolicySource,
    label: str,
    workers: EpisodeWorkers,
    progress: Progress,
    indices: Sequence[int] | None = None,
    *,
    record: bool = False,
) -> list[EpisodeResult]:
    """Let workers play the episodes with these indices, or all, and show the progress.

    There are fewer results, and ``workers.interrupted`` is set, if ``workers.stop`` returns True.
    """
    settings = config.eval
    chosen = range(settings.episodes) if indices is None else indices
    results: list[EpisodeResult] = []
    if chosen and workers.stop():
        workers.interrupted = True
        return results
    with progress(label, len(chosen)) as report:

        def search(fraction: float) -> None:
            report(len(results) + fraction)

        for result in play_episodes(
            config,
            source,
            episodes=chosen,
            seed=settings.seed,
            workers=workers,
            report_progress=search,
            record=record,
        ):
            results.append(result)
            report(len(results))
    workers.interrupted |= len(results) < len(chosen)
    return results
