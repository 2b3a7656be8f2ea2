"""Play the episodes of the cells of a map, in this process or in several.

In: a configuration for each cell, and a policy's source. Out: the results of each cell's episodes.
A worker plays one whole cell after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

from flipperctl import plugins
from flipperctl.config import EnvConfig, EvalConfig, parse, to_dict
from flipperctl.errors import FlipperctlError
from flipperctl.evaluation.axes import Axis, cell_config
from flipperctl.evaluation.capability import CapabilityMap, Index, sample_cells
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.episodes import play_episodes
from flipperctl.evaluation.judging import Progress, no_progress
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.pool import WorkerDiedError, WorkerPool

_TRIES = 3
"""Number of times that a cell is played whose worker dies."""


def capability_map(
    config: EvalConfig,
    source: PolicySource,
    axes: tuple[Axis, Axis],
    *,
    progress: Progress = no_progress,
    stop: Callable[[], bool] = lambda: False,
) -> CapabilityMap:
    """Return the map of a policy; ``config.eval`` has the episodes of a cell, seed and jobs.

    A cell's episodes are those of an evaluation with the values of the axes as overrides. Once
    ``stop``, called before each cell, returns True, the map has the finished cells alone.

    Raises:
        ConfigError: a cell is not possible; this is found before any episode.
        FlipperctlError: the policy cannot be built or failed, or a cell killed its workers.
    """
    first, second = axes
    size = len(first.values), len(second.values)
    configs = {
        (i, j): cell_config(config, axes, (i, j)) for i in range(size[0]) for j in range(size[1])
    }
    failures: dict[Index, EpisodeResult] = {}
    source.build(configs[0, 0])  # raises for a wrong layout or robot, before the first episode
    with _CellPlayer(source, config.eval.episodes, config.eval.seed, config.eval.jobs) as player:

        def play(
            cells: Sequence[Index], label: str
        ) -> Iterator[tuple[Index, Sequence[EpisodeResult]]]:
            with progress(label, len(cells)) as report:
                played = player.play([configs[cell] for cell in cells], stop)
                for done, (cell, episodes) in enumerate(zip(cells, played, strict=False), 1):
                    if failed := [episode for episode in episodes if not episode.reached]:
                        failures[cell] = failed[0]
                    yield cell, episodes
                    report(done)

        cells, complete = sample_cells(size, play)
    return CapabilityMap(
        source.label(),
        config.terrain.plugin_name,
        axes,
        cells,
        config.eval.episodes,
        config.eval.seed,
        Conditions.of(config),
        interrupted=not complete,
        failures=failures,
    )


@dataclass(frozen=True)
class _Task:
    """The episodes of one cell, as another process can be given them."""

    config: dict[str, Any]
    source: PolicySource
    episodes: int
    seed: int
    plugin_paths: list[str]


class _CellPlayer:
    """Plays cells in ``jobs`` processes, or in this one if there is one job."""

    def __init__(self, source: PolicySource, episodes: int, seed: int, jobs: int) -> None:
        self._source, self._episodes, self._seed = source, episodes, seed
        self._pool = WorkerPool(jobs, _use_one_thread, ()) if jobs > 1 else None

    def __enter__(self) -> _CellPlayer:
        return self

    def __exit__(self, *error: object) -> None:
        if self._pool is not None:
            self._pool.close()

    def play(
        self, configs: Sequence[EvalConfig], stop: Callable[[], bool]
    ) -> Iterator[list[EpisodeResult]]:
        """Yield the episodes of each configuration in order; fewer once ``stop`` returns True."""
        if self._pool is None:
            for config in configs:
                if stop():
                    return
                episodes, seed = self._episodes, self._seed
                yield list(play_episodes(config, self._source, episodes=episodes, seed=seed))
            return
        tasks = [self._task(config) for config in configs]
        waiting = [self._pool.submit(_play_in_worker, task) for task in tasks]
        for task, job in zip(tasks, waiting, strict=True):
            if stop() and not job.done():
                return
            yield self._result(self._pool, task, job)

    def _task(self, config: EvalConfig) -> _Task:
        document = to_dict(config.environment())
        paths = plugins.configured_paths()
        return _Task(document, self._source, self._episodes, self._seed, paths)

    @staticmethod
    def _result(
        pool: WorkerPool, task: _Task, job: Future[list[EpisodeResult]]
    ) -> list[EpisodeResult]:
        """Wait for a cell; play it again, which its seeds make exact, if its worker died."""
        for _ in range(_TRIES + pool.count):
            try:
                return job.result()
            except WorkerDiedError:
                job = pool.submit(_play_in_worker, task)
        raise FlipperctlError("a cell of the map repeatedly killed its worker")


def _use_one_thread() -> None:
    import torch

    torch.set_num_threads(1)


def _play_in_worker(task: _Task) -> list[EpisodeResult]:
    plugins.load(task.plugin_paths)
    config = parse(EnvConfig, task.config)
    return list(play_episodes(config, task.source, episodes=task.episodes, seed=task.seed))
