"""Evaluate a policy on scenes, together with baselines and references.

In: a configuration and a policy's source for each scene. Out: an ``EvaluationResult`` for
the command line, reports and other programs; nothing is printed or written here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import repeat

from flipperctl.config import EvalConfig
from flipperctl.errors import FlipperctlError, InterruptedRunError
from flipperctl.evaluation.bounds import static_bounds, with_bounds
from flipperctl.evaluation.comparisons import correct_together
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.failed_policies import Failure
from flipperctl.evaluation.interruption import Interruption
from flipperctl.evaluation.judging import NOT_A_POLICYS, Judge, Progress, no_progress
from flipperctl.evaluation.naming import NAMELESS, SceneName
from flipperctl.evaluation.ray_cells import play_over_ray
from flipperctl.evaluation.results import BaselineResult, EvaluationResult, SceneResult
from flipperctl.evaluation.sensing import causes
from flipperctl.evaluation.statistics import differences, summarise
from flipperctl.evaluation.store import EpisodeStore
from flipperctl.evaluation.workers import EpisodeWorkers
from flipperctl.policies.source import PolicySource

Scene = tuple[EvalConfig, PolicySource]
"""``config.eval`` holds the number of episodes and the seed."""


def evaluate(
    scenes: Sequence[Scene],
    *,
    baselines: Sequence[PolicySource] = (),
    references: Sequence[PolicySource] = (),
    progress: Progress = no_progress,
    record: bool = False,
    stop: Callable[[], bool] = lambda: False,
    store: EpisodeStore | None = None,
    names: Sequence[SceneName] = (),
    plan: Callable[[int], None] = lambda episodes: None,
) -> EvaluationResult:
    """Evaluate a policy on each scene, in as many processes as the scene asks for.

    ``baselines`` play the same episodes for comparison. ``references`` determine which episodes can
    be crossed at all: each tries those that no earlier one crossed, whatever the policy did.
    ``record``: whether the policy's results include decisions. Once ``stop``, called before each
    episode, returns True, the evaluation ends with the finished episodes. Episodes that the
    ``store`` has are not played again; new ones are added to it. A policy that fails on a scene is
    among the ``failures`` of the result, unless all fail. ``names``: one for each of the scenes of
    several methods. ``plan`` is called once with the number of episodes that the store lacks.

    Raises:
        FlipperctlError: every policy cannot be built or failed, or an episode killed its workers.
        InterruptedRunError: it was stopped before any episode was finished.
        OutputError, WriteError: the store cannot be written.
        ValueError: there are no scenes.
    """
    if not scenes:
        raise ValueError("an evaluation needs at least one scene")
    results: list[SceneResult | None] = []
    failures: list[Failure] = []
    with EpisodeWorkers(stop=stop) as workers:
        judge = Judge(EpisodeStore() if store is None else store, workers, progress)
        plan(_lacking(judge, scenes, baselines))
        if scenes[0][0].eval.ray is not None and not record:
            every = [(config, who) for config, source in scenes for who in (source, *baselines)]
            play_over_ray(judge, every, stop)
        for (config, source), name in zip(scenes, names or repeat(NAMELESS)):  # noqa: B905
            scene = _SceneEpisodes(config, judge, failures)
            found = _evaluate_scene(scene, source, baselines, references, record, name)
            results.append(None if found is None else replace(found, index=len(results)))
    finished = [result for result in results if result is not None]
    if failures and not finished:
        raise failures[0].error
    interruption = None
    if workers.interrupted:
        interruption = _interruption(scenes, results, 1 + len(baselines))
    return EvaluationResult(tuple(_corrected(finished)), interruption, tuple(failures))


def _lacking(judge: Judge, scenes: Sequence[Scene], baselines: Sequence[PolicySource]) -> int:
    """Return the number of episodes that the store lacks, without those of references."""
    found: dict[tuple[str, int], None] = {}
    for config, source in scenes:
        for one in (source, *baselines):
            with suppress(FlipperctlError):  # which judging raises again, where it is noted
                key = judge.series(config, one).key
                cells = judge.missing(config, one)
                found |= dict.fromkeys((key, index) for cell in cells for index in cell)
    return len(found)


def _interruption(
    scenes: Sequence[Scene], results: Sequence[SceneResult | None], players: int
) -> Interruption:
    """Return the finished and planned episodes of the policy and its baselines."""
    planned = players * sum(config.eval.episodes for config, _ in scenes)
    names = [config.terrain.plugin_name for config, _ in scenes]
    if any(source != scenes[0][1] for _, source in scenes):
        names = [f"{who.label()} on {name}" for name, (_, who) in zip(names, scenes, strict=True)]
    finished = sum(result.finished for result in results if result is not None)
    if not finished:
        raise InterruptedRunError(f"interrupted: none of {planned} episodes is finished")
    missing = [name for name, result in zip(names, results, strict=True) if result is None]
    return Interruption(finished, planned, tuple(missing))


class _SceneEpisodes:
    """The episodes of a scene, played by several policies, and by equal ones only once."""

    def __init__(self, config: EvalConfig, judge: Judge, failures: list[Failure]) -> None:
        """``failures`` takes each policy that fails on the scene."""
        self.config = config
        self.terrain = config.terrain.plugin_name
        self._judge, self._failures = judge, failures

    def play(
        self,
        source: PolicySource,
        label: str,
        indices: Sequence[int] | None = None,
        *,
        record: bool = False,
        config: EvalConfig | None = None,
    ) -> list[EpisodeResult]:
        """Return the episodes of a policy, or the first ones if the workers were stopped.

        ``config``: another sensing of the same episodes. Those of a policy that fails are left
        out: the rest would favour it.
        """
        try:
            scene = self.config if config is None else config
            return self._judge.judge(scene, source, label, indices, record=record)
        except NOT_A_POLICYS:
            raise
        except FlipperctlError as error:
            self._failures.append(Failure(source.label(), self.terrain, error))
            return []

    def with_causes(
        self, source: PolicySource, episodes: Sequence[EpisodeResult]
    ) -> list[EpisodeResult]:
        """Return the episodes, the failed ones with their cause if the sensor maps the ground."""

        def again(config: EvalConfig, indices: Sequence[int]) -> list[EpisodeResult]:
            label = f"{self.terrain}, failed episodes again"
            return self.play(source, label, indices, config=config)

        failed = [e for e in episodes if not e.reached]
        found = {} if self._judge.workers.interrupted else causes(self.config, failed, again)
        known = {index: str(cause) for index, cause in found.items()}
        return [replace(e, failed_by=known.get(e.episode)) for e in episodes]

    def static_bounds(self, episodes: Sequence[EpisodeResult]) -> dict[int, float]:
        """Return the static bound of each episode by its seed, if it is asked for."""
        workers = self._judge.workers
        if not self.config.eval.static_bound or workers.interrupted:
            return {}
        with self._judge.progress(f"{self.terrain}, static bounds", len(episodes)) as report:
            seeds = [e.seed for e in episodes]
            return static_bounds(self.config, seeds, report, workers.stop)

    def crossed_by(self, references: Sequence[PolicySource]) -> dict[int, str] | None:
        """Return the first reference that crosses each episode, by index; empty if none does.

        Return None if one was stopped or failed, since untried episodes are then unknown.
        """
        failed = len(self._failures)
        found = dict.fromkeys(range(self.config.eval.episodes), "")
        for reference in references:
            name = reference.label()
            played = self._judge.known(self.config, reference)
            if played is None:
                left = [index for index, label in found.items() if not label]
                label = f"{self.terrain}, {name} on episodes not crossed yet"
                played = self.play(reference, label, left)
            found |= {e.episode: name for e in played if e.reached and not found[e.episode]}
        whole = not self._judge.workers.interrupted and len(self._failures) == failed
        return found if whole else None


def _evaluate_scene(
    scene: _SceneEpisodes,
    source: PolicySource,
    baselines: Sequence[PolicySource],
    references: Sequence[PolicySource],
    record: bool,
    name: SceneName,
) -> SceneResult | None:
    """Return the result of a scene; None if no episode was finished before a stop or a failure."""
    terrain = scene.terrain
    label = f"{terrain}, {name.method_text}" if name.method else terrain
    episodes = scene.play(source, label, record=record)
    if not episodes:
        return None
    episodes = scene.with_causes(source, episodes)
    others = [(b.label(), scene.play(b, f"{terrain}, {b.label()}")) for b in baselines]
    if references and (crossed_by := scene.crossed_by(references)) is not None:
        episodes = [replace(e, crossed_by=crossed_by[e.episode]) for e in episodes]
    bounds = scene.static_bounds(episodes)
    episodes = with_bounds(episodes, bounds)
    others = [(label, with_bounds(played, bounds)) for label, played in others]
    return SceneResult(
        source.label(),
        summarise(terrain, episodes),
        scene.config.eval.seed,
        Conditions.of(scene.config),
        tuple(compare(terrain, episodes, label, played) for label, played in others if played),
        tuple(episodes),
        name,
    )


def _corrected(scenes: Sequence[SceneResult]) -> Iterator[SceneResult]:
    """Yield the scenes with the p-values of all their comparisons corrected together."""
    every = [baseline.difference for scene in scenes for baseline in scene.baselines]
    corrected = iter(correct_together(every))
    for scene in scenes:
        baselines = (replace(b, difference=next(corrected)) for b in scene.baselines)
        yield replace(scene, baselines=tuple(baselines))


def compare(
    terrain: str, ours: Sequence[EpisodeResult], label: str, theirs: Sequence[EpisodeResult]
) -> BaselineResult:
    """Return the summary of a baseline's episodes, and our differences from them.

    Raises:
        ValueError: there are no episodes.
    """
    return BaselineResult(
        label, summarise(terrain, theirs), differences(ours, theirs), tuple(theirs)
    )
