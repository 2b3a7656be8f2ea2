"""Worker processes of an evaluation, which play the episodes of one policy after the other.

In: an environment configuration and a policy's source. Out: one result per episode, in order. A
worker takes the next episode as soon as it is free.
"""

from __future__ import annotations

import itertools
import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from flipperctl import plugins
from flipperctl.config import EnvConfig, parse, to_dict
from flipperctl.errors import FlipperctlError
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.runner import EpisodeRunner
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.pool import WorkerDiedError, WorkerPool

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Task:
    """The policy, environment and seed of the episodes that a worker plays."""

    number: int
    """Identifies the task; a worker reuses the environment and policy that it built for it."""
    config: dict[str, Any]
    source: PolicySource
    seed: int
    record: bool
    plugin_paths: list[str]


class EpisodeWorkers:
    """``count`` processes, which start with the first episodes; a process that dies is replaced."""

    def __init__(self, count: int = 1, stop: Callable[[], bool] = lambda: False) -> None:
        """``stop`` is called before each episode; once it returns True, no other episode begins."""
        self.count = count
        self.stop = stop
        self.interrupted = False
        """Whether episodes were left out because of ``stop``."""
        self._pool: WorkerPool | None = None
        self._numbers = itertools.count()

    def __enter__(self) -> EpisodeWorkers:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def play(
        self,
        config: EnvConfig,
        source: PolicySource,
        indices: Sequence[int],
        seed: int,
        *,
        record: bool = False,
    ) -> Iterator[EpisodeResult]:
        """Yield the results of these episodes, in order; see ``play_episodes``.

        After a stop, finished results are yielded up to the first unfinished one.
        """
        document = to_dict(config.environment())
        paths = plugins.configured_paths()
        task = _Task(next(self._numbers), document, source, seed, record, paths)
        if self._pool is None:
            self._pool = WorkerPool(self.count, _use_one_thread, ())
        pool = self._pool
        waiting = deque(pool.submit(_play_in_worker, task, index) for index in indices)
        try:
            for index in indices:
                if self.stop() and not waiting[0].done():
                    return
                yield _result(pool, task, waiting.popleft(), index)
        finally:  # after a failure, another policy's episodes come next
            for job in waiting:
                job.cancel()

    def use(self, count: int) -> None:
        """Change the number of processes; if it differs, running ones are stopped."""
        if count != self.count:
            self.close()
            self.count = count

    def close(self) -> None:
        """Stop the processes; episodes that have not begun are not played."""
        if self._pool is not None:
            self._pool.close()
            self._pool = None


def _result(pool: WorkerPool, task: _Task, job: Future[EpisodeResult], index: int) -> EpisodeResult:
    """Wait for an episode; replay it, which its seed makes exact, if its worker died."""
    for _ in range(pool.count + 2):  # all may have died at once
        try:
            return job.result()
        except WorkerDiedError:
            _log.warning("a worker died and is replaced; episode %d is played again", index)
            job = pool.submit(_play_in_worker, task, index)
    raise FlipperctlError(f"episode {index} of the evaluation repeatedly killed its worker")


_runner: tuple[int, EpisodeRunner] | None = None  # the newest task's, one per worker process


def _use_one_thread() -> None:
    import torch

    torch.set_num_threads(1)


def _play_in_worker(task: _Task, index: int) -> EpisodeResult:
    global _runner
    if _runner is None or _runner[0] != task.number:
        plugins.load(task.plugin_paths)
        config = parse(EnvConfig, task.config)
        _runner = task.number, EpisodeRunner(config, task.source, task.seed, record=task.record)
    return _runner[1].play(index)
