"""Plays episodes for rows, in this process or in several."""

from __future__ import annotations

import hashlib
import itertools
import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import numpy as np

from flipperctl import plugins
from flipperctl.api import Profile, Transition
from flipperctl.config import EnvConfig, EvalConfig, parse, to_dict
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.repeating import require_repeatable
from flipperctl.errors import CheckpointError, FlipperctlError
from flipperctl.evaluation.rows import DIGEST, RECORDED, Row, arranged
from flipperctl.policies.identity import PolicyIdentity
from flipperctl.policies.source import PolicySource
from flipperctl.policies.teaching import DemonstratingPolicy
from flipperctl.rollout.episode import Decision, EpisodeRecorder, decisions, play
from flipperctl.rollout.pool import Host, WorkerDiedError, WorkerPool
from flipperctl.rollout.seeds import EvaluationSeeds


class EpisodeDigest:
    """SHA-256 of each decision's action and of the poses at 100 Hz: equal for equal episodes."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def add(self, decision: Decision) -> None:
        """Add the action and the poses (S + 1, 5) of a decision, as little-endian numbers."""
        self._hash.update(int(decision.action).to_bytes(1, "little"))
        self._hash.update(np.ascontiguousarray(decision.poses, dtype="<f8").tobytes())

    def hexdigest(self) -> str:
        """Return the digest of the decisions so far."""
        return self._hash.hexdigest()


class EpisodeRunner:
    """An environment and a policy, ready to play any episode of an evaluation."""

    def __init__(
        self,
        config: EnvConfig,
        source: PolicySource,
        seed: int,
        report_progress: Callable[[float], None] = lambda fraction: None,
        *,
        record: bool = False,
    ) -> None:
        """Build the environment and the policy.

        ``seed`` is the seed of the evaluation. ``report_progress`` is called with the finished
        fraction of an episode's search. ``record``: whether rows include the decisions.
        """
        self.env = FlipperEnv(config=config)
        self._report_progress = report_progress
        self._policy = source.build(config)
        self._seeds = EvaluationSeeds.of(seed, config.terrain)
        self._record = record
        require_repeatable(self.env, self._seeds(0))

    def play(self, index: int) -> Row:
        """Play one episode, counted from 0, to its end; return its row."""
        digest, report, seed = EpisodeDigest(), self._report_progress, self._seeds(index)
        if not self._record:
            row = play(self.env, self._policy, seed, watch=digest.add, report_progress=report)
            return arranged({"episode": index, **row}) | {DIGEST: digest.hexdigest()}
        policy, recorder = DemonstratingPolicy(self._policy), EpisodeRecorder()

        def watch(d: Decision) -> None:
            before, after = d.perception.observation, d.next_perception.observation
            recorder.add(before, d.action, d.reward, after, policy.label)
            digest.add(d)

        row = play(self.env, policy, seed, watch=watch, report_progress=report)
        recorded = {DIGEST: digest.hexdigest(), RECORDED: recorder.finish(index, row)}
        return arranged({"episode": index, **row}) | recorded

    def transitions(self, index: int) -> tuple[list[Transition], Profile]:
        """Play one episode; return its T transitions, and the ground."""
        seed = self._seeds(index)
        made = decisions(self.env, self._policy, seed, report_progress=self._report_progress)
        return [d.transition for d in made], self.env.profile


_log = logging.getLogger(__name__)
_numbers = itertools.count()


@dataclass(frozen=True)
class Task:
    """The policy, environment and seed of episodes, as another process can be given them."""

    number: int
    """Identifies the task; a worker reuses the environment and policy that it built for it."""
    config: dict[str, Any]
    source: PolicySource
    seed: int
    record: bool
    plugin_paths: list[str]

    @classmethod
    def of(cls, config: EvalConfig, source: PolicySource, *, record: bool = False) -> Task:
        """Return a new task."""
        document, paths = to_dict(config.environment()), plugins.configured_paths()
        return cls(next(_numbers), document, source, config.eval.seed, record, paths)


class EpisodeWorkers:
    """``count`` processes, which start with the first episodes; a process that dies is replaced.

    One worker is this process.
    """

    def __init__(self, count: int = 1, stop: Callable[[], bool] = lambda: False) -> None:
        """``stop`` is called before each episode; once it returns True, no other episode begins."""
        self.count, self.stop = count, stop
        self.interrupted = False
        """Whether episodes were left out because of ``stop``."""
        self._pool: WorkerPool | None = None

    def __enter__(self) -> EpisodeWorkers:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def play(
        self,
        config: EvalConfig,
        source: PolicySource,
        indices: Sequence[int],
        *,
        report_progress: Callable[[float], None] = lambda fraction: None,
        record: bool = False,
    ) -> Iterator[Row]:
        """Yield the rows of these episodes, in order, each as soon as it is available.

        Fewer are played, and ``interrupted`` is set, once ``stop`` returns True. A lone worker
        calls ``report_progress`` with the finished fraction of an episode's search. ``record``:
        whether rows include the decisions.

        Raises:
            FlipperctlError: the policy cannot be built or failed, or an episode killed its workers.
        """
        if self.count > 1 and len(indices) > 1:
            for rows in self.play_many([(config, source, indices)], record=record):
                yield from rows
        elif indices and not self._stopped():
            runner = EpisodeRunner(config, source, config.eval.seed, report_progress, record=record)
            for at, index in enumerate(indices):
                if at and self._stopped():
                    return
                yield runner.play(index)

    def _stopped(self) -> bool:
        self.interrupted = self.interrupted or self.stop()
        return self.interrupted

    def play_many(
        self,
        requests: Sequence[tuple[EvalConfig, PolicySource, Sequence[int]]],
        *,
        record: bool = False,
    ) -> Iterator[Iterator[Row]]:
        """Yield the rows of each request; several processes share all requests at once.

        See ``play``. The rows of a request must be taken before those of the next one.
        """
        if self.count == 1:
            yield from (self.play(*request, record=record) for request in requests)
            return
        if self._pool is None:
            self._pool = worker_pool(self.count)
        pool = self._pool
        waiting: deque[tuple[Task, int, Future[Row]]] = deque()
        for config, source, indices in requests:
            task = Task.of(config, source, record=record)
            waiting += ((task, i, pool.submit(_play_in_worker, task, i)) for i in indices)
        try:
            for _, _, indices in requests:
                yield self._rows(pool, waiting, len(indices))
        finally:  # after a failure, another policy's episodes come next
            for _, _, job in waiting:
                job.cancel()

    def _rows(
        self, pool: WorkerPool, waiting: deque[tuple[Task, int, Future[Row]]], count: int
    ) -> Iterator[Row]:
        for _ in range(count):
            if self.interrupted or (self.stop() and not waiting[0][2].done()):
                self.interrupted = True
                return
            yield _result(pool, *waiting.popleft())

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


def _result(pool: WorkerPool, task: Task, index: int, job: Future[Row]) -> Row:
    """Wait for an episode; if its worker died, play it again (same seed, same result)."""
    for _ in range(pool.count + 2):  # all may have died at once
        try:
            return job.result()
        except WorkerDiedError:
            _log.warning("a worker died and is replaced; episode %d is played again", index)
            job = pool.submit(_play_in_worker, task, index)
    raise FlipperctlError(f"episode {index} of the evaluation repeatedly killed its worker")


def worker_pool(count: int, start: Callable[[], Host] | None = None) -> WorkerPool:
    """Return a pool whose workers play episodes of tasks; ``start`` starts one elsewhere."""
    return WorkerPool(count, _use_one_thread, (), start)


_runner: tuple[int, EpisodeRunner] | None = None  # the newest task's, one per worker process


def _use_one_thread() -> None:
    import torch

    torch.set_num_threads(1)


def _play_in_worker(task: Task, index: int) -> Row:
    return _worker_runner(task).play(index)


def _worker_runner(task: Task) -> EpisodeRunner:
    """Return the runner of a task in a worker process, built with its first episode."""
    global _runner
    if _runner is None or _runner[0] != task.number:
        plugins.load(task.plugin_paths)
        config = parse(EnvConfig, task.config)
        runner = EpisodeRunner(config, task.source, task.seed, record=task.record)
        _runner = task.number, runner
    return _runner[1]


def play_block(task: Task, block: Sequence[int], digest: str) -> list[Row]:
    """Play the episodes of a block in a worker on another machine, which must have the policy."""
    runner = _worker_runner(task)
    require_unchanged(task.source, digest)
    return [runner.play(index) for index in block]


def require_unchanged(source: PolicySource, digest: str) -> None:
    """Refuse a policy that has not the ``digest`` any more, since its episodes would mix two."""
    if PolicyIdentity.of(source).digest != digest:
        raise CheckpointError(
            f"{source.label()} has changed since the evaluation began; is it still being trained? "
            "Evaluate it again when it is finished, or a copy of its file"
        )
