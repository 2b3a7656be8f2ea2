"""Play what a store lacks of a policy's episodes, cell by cell.

In: a configuration, a policy's source and the indices of episodes. Out: their results, of which
each is played once, however many scenes and policies ask for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager

from flipperctl.config import EvalConfig
from flipperctl.errors import (
    CheckpointError,
    FlipperctlError,
    InterruptedRunError,
    OutputError,
    WriteError,
)
from flipperctl.evaluation.cells import Series, cut
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.episodes import play_episodes
from flipperctl.evaluation.store import EpisodeStore
from flipperctl.evaluation.workers import EpisodeWorkers
from flipperctl.policies.identity import PolicyIdentity
from flipperctl.policies.source import PolicySource

Progress = Callable[[str, int], AbstractContextManager[Callable[[float], None]]]
"""Opens a progress display from a label and a number of episodes. Its context manager yields a
function of the number of finished episodes, in which a search counts as a fraction of its episode.
"""

NOT_A_POLICYS = (InterruptedRunError, OutputError, WriteError)
"""Errors that end an evaluation; any other one ends only the episodes of its policy on its scene.
"""


@contextmanager
def no_progress(label: str, episodes: int) -> Iterator[Callable[[float], None]]:
    """Show nothing."""
    yield lambda done: None


class Judge:
    """Takes episodes from a store, and lets workers play those that it lacks."""

    def __init__(
        self,
        store: EpisodeStore,
        workers: EpisodeWorkers,
        progress: Progress = no_progress,
    ) -> None:
        self.store, self.workers, self.progress = store, workers, progress
        self._identities: list[tuple[PolicySource, PolicyIdentity]] = []

    def series(self, config: EvalConfig, source: PolicySource) -> Series:
        """Return the series of a policy's episodes under a configuration.

        Raises:
            FlipperctlError: the policy's file cannot be read.
        """
        known = next((found for who, found in self._identities if who == source), None)
        if known is None:
            known = PolicyIdentity.of(source)
            self._identities.append((source, known))
        return Series.of(config, known)

    def missing(self, config: EvalConfig, source: PolicySource) -> list[list[int]]:
        """Return the cells of the evaluation that the store lacks, as indices of episodes."""
        held = self.store.find(self.series(config, source))
        lacking = [i for i in range(config.eval.episodes) if i not in held]
        return list(cut(lacking, config.eval.cell))

    def known(self, config: EvalConfig, source: PolicySource) -> list[EpisodeResult] | None:
        """Return all episodes of the evaluation if the store has them, else None."""
        held = self.store.find(self.series(config, source))
        wanted = range(config.eval.episodes)
        return [held[i] for i in wanted] if all(i in held for i in wanted) else None

    def judge(
        self,
        config: EvalConfig,
        source: PolicySource,
        label: str,
        indices: Sequence[int] | None = None,
        *,
        record: bool = False,
    ) -> list[EpisodeResult]:
        """Return the episodes at ``indices``, or all of the evaluation; fewer after a stop.

        ``record``: play all, since stored results have no decisions.

        Raises:
            OutputError, WriteError: a cell cannot be written.
            FlipperctlError: the policy cannot be built or failed. The cells before the failure are
                stored, and the failure is noted.
        """
        chosen = list(range(config.eval.episodes)) if indices is None else list(indices)
        series = self.series(config, source)
        held = {} if record else self.store.find(series)
        missing = [index for index in chosen if index not in held]
        if chosen and not missing:
            return [held[index] for index in chosen]
        fresh = self._play(config, source, label, series, missing, record)
        found = held | {episode.episode: episode for episode in fresh}
        return [found[index] for index in chosen if index in found]

    def _play(
        self,
        config: EvalConfig,
        source: PolicySource,
        label: str,
        series: Series,
        missing: Sequence[int],
        record: bool,
    ) -> list[EpisodeResult]:
        stored = self.store.find(series)
        ends = [cell[-1] for cell in cut([i for i in missing if i not in stored], config.eval.cell)]
        played: list[EpisodeResult] = []
        kept = 0

        def keep() -> None:
            nonlocal kept
            part, kept = [e for e in played[kept:] if e.episode not in stored], len(played)
            if part:
                require_unchanged(source, series.policy.digest)
                self.store.add(series, part)

        def take(result: EpisodeResult) -> None:
            played.append(result)
            if result.episode in ends:
                keep()

        require_unchanged(source, series.policy.digest)
        try:
            play_scene(
                *(config, source, label, self.workers, self.progress, missing),
                record=record,
                take=take,
            )
        except NOT_A_POLICYS:
            raise
        except FlipperctlError as error:
            first = missing[len(played)]
            last = next((end for end in ends if end >= first), first)
            self.store.fail(series, first, last, error)
            raise
        finally:
            keep()  # also what an interrupted cell has
        return played


def require_unchanged(source: PolicySource, digest: str) -> None:
    """Refuse a policy that has not the ``digest`` any more, since its episodes would mix two.

    Raises:
        CheckpointError: its file was replaced, as a run that is trained replaces its best policy.
    """
    if PolicyIdentity.of(source).digest != digest:
        raise CheckpointError(
            f"{source.label()} has changed since the evaluation began; is it still being trained? "
            "Evaluate it again when it is finished, or a copy of its file"
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
    take: Callable[[EpisodeResult], None] = lambda result: None,
) -> list[EpisodeResult]:
    """Let ``config.eval.jobs`` workers play the episodes at ``indices``, or all of them.

    The progress is shown under the label; ``take`` is called with each result, in order. There are
    fewer results, and ``workers.interrupted`` is set, if ``workers.stop`` returns True.
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
            take(result)
            report(len(results))
    workers.interrupted |= len(results) < len(chosen)
    return results
