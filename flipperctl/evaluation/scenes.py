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
from flipperctl.evaluation.bounds import static_bounds, with_bounds
from flipperctl.evaluation.comparisons import correct_together
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.episodes import play_episodes
from flipperctl.evaluation.interruption import Interruption
from flipperctl.evaluation.results import BaselineResult, EvaluationResult, SceneResult
from flipperctl.evaluation.sensing import causes
from flipperctl.evaluation.statistics import differences, summarise
from flipperctl.evaluation.workers import EpisodeWorkers
from flipperctl.policies.source import PolicySource

Scene = tuple[EvalConfig, PolicySource]
"""``config.eval`` holds the number of episodes and the seed."""
Progress = Callable[[str, int], AbstractContextManager[Callable[[float], None]]]
"""Opens a progress display from a label and a number of episodes. Its context manager yields a
function of the number of finished episodes, in which a search counts as a fraction of its episode.
"""


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
    """Evaluate a policy on each scene, in as many processes as the scene asks for.

    ``baselines`` play the same episodes for comparison. ``references`` determine which episodes can
    be crossed at all: each tries those that no earlier one crossed, whatever the policy did.
    ``record``: whether the policy's results include decisions. Once ``stop``, called before each
    episode, returns True, the evaluation ends with the finished episodes.

    Raises:
        FlipperctlError: a policy cannot be built or failed, or an episode killed its workers.
        InterruptedRunError: it was stopped before any episode was finished.
        ValueError: there are no scenes.
    """
    if not scenes:
        raise ValueError("an evaluation needs at least one scene")
    with EpisodeWorkers(stop=stop) as workers:
        results = [
            _evaluate_scene(
                _SceneEpisodes(config, workers, progress), s, baselines, references, record
            )
            for config, s in scenes
        ]
    interruption = None
    if workers.interrupted:
        interruption = _interruption([config for config, _ in scenes], results, 1 + len(baselines))
    finished = [result for result in results if result is not None]
    return EvaluationResult(tuple(_corrected(finished)), interruption)


def _interruption(
    configs: Sequence[EvalConfig], results: Sequence[SceneResult | None], players: int
) -> Interruption:
    """Return the finished and planned episodes of the policy and its baselines."""
    planned = players * sum(config.eval.episodes for config in configs)
    finished = sum(result.finished for result in results if result is not None)
    if not finished:
        raise InterruptedRunError(f"interrupted: none of {planned} episodes is finished")
    pairs = zip(configs, results, strict=True)
    missing = [config.terrain.plugin_name for config, result in pairs if result is None]
    return Interruption(finished, planned, tuple(missing))


class _SceneEpisodes:
    """The episodes of a scene, played by several policies, and by equal ones only once."""

    def __init__(self, config: EvalConfig, workers: EpisodeWorkers, progress: Progress) -> None:
        self.config = config
        self.terrain = config.terrain.plugin_name
        self._workers, self._progress = workers, progress
        self._played: list[tuple[PolicySource, list[EpisodeResult]]] = []

    def play(
        self, source: PolicySource, label: str, *, record: bool = False
    ) -> list[EpisodeResult]:
        """Return all episodes of a policy, or the first ones if the workers were stopped."""
        known = self._known(source)
        if known is None:
            known = play_scene(
                self.config, source, label, self._workers, self._progress, record=record
            )
            self._played.append((source, known))
        return known

    def with_causes(
        self, source: PolicySource, episodes: Sequence[EpisodeResult]
    ) -> list[EpisodeResult]:
        """Return the episodes, the failed ones with their cause if the sensor maps the ground."""

        def again(config: EvalConfig, indices: Sequence[int]) -> list[EpisodeResult]:
            label = f"{self.terrain}, failed episodes again"
            return play_scene(config, source, label, self._workers, self._progress, indices)

        failed = [e for e in episodes if not e.reached]
        found = {} if self._workers.interrupted else causes(self.config, failed, again)
        known = {index: str(cause) for index, cause in found.items()}
        return [replace(e, failed_by=known.get(e.episode)) for e in episodes]

    def static_bounds(self, episodes: Sequence[EpisodeResult]) -> dict[int, float]:
        """Return the static bound of each episode by its seed, if it is asked for."""
        if not self.config.eval.static_bound or self._workers.interrupted:
            return {}
        with self._progress(f"{self.terrain}, static bounds", len(episodes)) as report:
            seeds = [e.seed for e in episodes]
            return static_bounds(self.config, seeds, report, self._workers.stop)

    def crossed_by(self, references: Sequence[PolicySource]) -> dict[int, str] | None:
        """Return the first reference that crosses each episode, by index; empty if none does.

        Return None if the references were stopped, since untried episodes are then unknown.
        """
        found = dict.fromkeys(range(self.config.eval.episodes), "")
        for reference in references:
            name = reference.label()
            left = [index for index, label in found.items() if not label]
            played = self._known(reference)
            if played is None:
                label = f"{self.terrain}, {name} on episodes not crossed yet"
                played = play_scene(
                    self.config, reference, label, self._workers, self._progress, left
                )
            found |= {e.episode: name for e in played if e.reached and not found[e.episode]}
        return None if self._workers.interrupted else found

    def _known(self, source: PolicySource) -> list[EpisodeResult] | None:
        return next((episodes for who, episodes in self._played if who == source), None)


def _evaluate_scene(
    scene: _SceneEpisodes,
    source: PolicySource,
    baselines: Sequence[PolicySource],
    references: Sequence[PolicySource],
    record: bool,
) -> SceneResult | None:
    """Return the result of a scene; None if it was stopped before any episode was finished."""
    terrain = scene.terrain
    episodes = scene.play(source, terrain, record=record)
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
    """Let ``config.eval.jobs`` workers play the episodes at ``indices``, or all of them.

    The progress is shown under the label. There are fewer results, and ``workers.interrupted`` is
    set, if ``workers.stop`` returns True.
    """
    settings = config.eval
    workers.use(settings.jobs)
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
