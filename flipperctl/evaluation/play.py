"""Play what a store lacks of the planned episodes: here, in worker processes or on a Ray cluster.

In: configurations and policies' sources. Out: rows of episodes, each of them played once,
however many scenes, policies and views ask for it.
"""

from __future__ import annotations

import hashlib
import itertools
import logging
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from flipperctl.api import Profile, Transition
from flipperctl.config import EnvConfig, EvalConfig, parse, to_dict
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.repeating import require_repeatable
from flipperctl.errors import (
    CheckpointError,
    FlipperctlError,
    InterruptedRunError,
    OutputError,
    WorkerDiffersError,
    WriteError,
)
from flipperctl.evaluation.rows import DIGEST, RECORDED, Episodes, Row, arranged
from flipperctl.evaluation.store import EpisodeStore, StoreKey, blocks
from flipperctl.plugging.guard import error_line, naming_plugins
from flipperctl.policies.controllers import DemonstratingPolicy, from_action
from flipperctl.policies.identity import PolicyIdentity
from flipperctl.policies.source import PolicySource
from flipperctl.rollout import cluster
from flipperctl.rollout.episode import (
    Decision,
    EpisodeRecorder,
    EvaluationSeeds,
    decisions,
    play,
    training_seed,
)
from flipperctl.rollout.pool import POLL, Host, WorkerDiedError, WorkerPool
from flipperctl.rollout.statement import Statement

Progress = Callable[[str, int], AbstractContextManager[Callable[[float], None]]]
"""Opens a progress display from a label and a number of episodes. Its context manager yields a
function of the number of finished episodes, in which a search counts as a fraction of its episode.
"""
NOT_A_POLICYS = (InterruptedRunError, OutputError, WriteError, WorkerDiffersError)
"""Errors that end an evaluation; any other one ends only the episodes of its policy on its scene.
"""
Request = tuple[EvalConfig, PolicySource]
"""A policy on a scene, whose ``eval`` has the number of episodes, their seed and the processes."""
_log = logging.getLogger(__name__)
_numbers = itertools.count()


@contextmanager
def no_progress(label: str, episodes: int) -> Iterator[Callable[[float], None]]:
    """Show nothing."""
    yield lambda done: None


class EpisodeDigest:
    """SHA-256 of each decision's action and of the poses at 100 Hz: equal for equal episodes."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self.hexdigest = self._hash.hexdigest

    def add(self, decision: Decision) -> None:
        """Add the action and the poses (S + 1, 5) of a decision, as little-endian numbers."""
        self._hash.update(int(decision.action).to_bytes(1, "little"))
        if decision.rates is not None:
            self._hash.update(np.array(decision.rates, "<f8").tobytes())
        self._hash.update(np.ascontiguousarray(decision.poses, dtype="<f8").tobytes())


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
        training: bool = False,
    ) -> None:
        """Build the environment and the policy.

        ``seed`` is the seed of the evaluation, or with ``training`` of a training, whose episodes
        no evaluation has. ``report_progress`` is called with the finished fraction of an
        episode's search. ``record``: whether rows include the decisions.
        """
        self.env = FlipperEnv(config=config)
        self._report_progress = report_progress
        self._policy = source.build(config)
        evaluated = EvaluationSeeds.of(seed, config.terrain)
        self._seeds = partial(training_seed, seed) if training else evaluated
        self._record = record
        require_repeatable(self.env, self._seeds(0))

    def play(self, index: int) -> Row:
        """Play one episode, counted from 0, to its end; return its row."""
        digest, report, seed = EpisodeDigest(), self._report_progress, self._seeds(index)
        # Evaluations need the row alone.
        if not self._record:
            row = play(self.env, self._policy, seed, watch=digest.add, report_progress=report)
            return arranged({"episode": index, **row}) | {DIGEST: digest.hexdigest()}
        # A recorded episode has its decisions with labels as well.
        policy, recorder = DemonstratingPolicy(self._policy), EpisodeRecorder(self.env.config.robot)

        def watch(d: Decision) -> None:
            before, after = d.perception.observation, d.next_perception.observation
            operated = d.transition.commands is not None  # the label is of ``act``
            label = from_action(d.action) if operated else policy.label
            recorder.add(before, d.action, d.reward, after, label)
            digest.add(d)

        row = play(self.env, policy, seed, watch=watch, report_progress=report)
        recorded = {DIGEST: digest.hexdigest(), RECORDED: recorder.finish(index, row)}
        return arranged({"episode": index, **row}) | recorded

    def transitions(self, index: int) -> tuple[list[Transition], Profile]:
        """Play one episode; return its T transitions, and the ground."""
        seed = self._seeds(index)
        played = decisions(self.env, self._policy, seed, report_progress=self._report_progress)
        return [d.transition for d in played], self.env.profile


@dataclass(frozen=True)
class Task:
    """The policy, environment and seed of episodes, as another process can be given them."""

    number: int
    """Identifies the task; a worker reuses the environment and policy that it built for it."""
    config: dict[str, Any]
    source: PolicySource
    seed: int
    record: bool
    training: bool
    inputs: Statement
    """What it needs beyond the code, which a worker states once."""

    @classmethod
    def of(
        cls,
        config: EvalConfig,
        source: PolicySource,
        *,
        record: bool = False,
        training: bool = False,
    ) -> Task:
        """Return a new task."""
        document, seed = to_dict(config.environment()), config.eval.seed
        inputs = Statement.of_inputs(config, source.checkpoint or source.controller())
        return cls(next(_numbers), document, source, seed, record, training, inputs)


class Player:
    """Takes episodes from a store, and plays those that it lacks.

    Worker processes start with the first episodes that need them, and live until the context ends.
    """

    def __init__(
        self,
        store: EpisodeStore | None = None,
        progress: Progress = no_progress,
        stop: Callable[[], bool] = lambda: False,
        *,
        training: bool = False,
    ) -> None:
        """``stop`` is called before each episode; once it returns True, no other episode begins.

        ``training``: whether the episodes are of trainings with the seed ``eval.seed``.
        """
        self.store = EpisodeStore() if store is None else store
        self.interrupted = False
        """Whether episodes were left out because of ``stop``."""
        self._progress, self._stop, self._training = progress, stop, training
        self._pool: WorkerPool | None = None
        self._identities: list[tuple[PolicySource, PolicyIdentity]] = []

    def __enter__(self) -> Player:
        return self

    def __exit__(self, *error: object) -> None:
        if self._pool is not None:
            self._pool.close()
            self._pool = None

    def key(self, config: EvalConfig, source: PolicySource) -> StoreKey:
        """Return the key of a policy's episodes under a configuration."""
        return StoreKey.of(config, self.identity(source))

    def identity(self, source: PolicySource) -> PolicyIdentity:
        """Return the identity that a policy had when it was first asked for."""
        known = next((identity for who, identity in self._identities if who == source), None)
        if known is None:
            known = PolicyIdentity.of(source)
            self._identities.append((source, known))
        return known

    def missing(self, config: EvalConfig, source: PolicySource) -> list[list[int]]:
        """Return the blocks of the evaluation that the store lacks, as indices of episodes."""
        stored = self.store.find(self.key(config, source))
        lacking = [i for i in range(config.eval.episodes) if i not in stored]
        return list(blocks(lacking, config.eval.cell))

    def play(
        self,
        config: EvalConfig,
        source: PolicySource,
        label: str,
        indices: Sequence[int] | None = None,
        *,
        record: bool = False,
    ) -> Episodes:
        """Return the episodes at ``indices``, or all of the evaluation; fewer after a stop.

        The progress is shown under the ``label``. ``record``: play all, since stored rows have no
        decisions.
        """
        wanted = list(range(config.eval.episodes)) if indices is None else list(indices)
        stored = {} if record else self.store.find(self.key(config, source))
        # Episodes that the store lacks are played and stored as they come.
        if missing := [index for index in wanted if index not in stored]:
            with self._progress(label, len(missing)) as report:
                done = 0

                def search(fraction: float) -> None:
                    report(done + fraction)

                requests = [(config, source, missing)]
                with closing(self._play(requests, search, record=record)) as played:
                    for row in self._kept(config, source, missing, next(played)):
                        stored[row["episode"]] = row
                        done += 1
                        report(done)
        return Episodes(tuple(stored[index] for index in wanted if index in stored))

    def play_many(self, requests: Sequence[Request], label: str) -> Iterator[Episodes]:
        """Yield the episodes of each request, in order; fewer requests after a stop.

        The episodes of all requests share the worker processes at once. The progress counts
        requests. See ``play``.
        """
        blocks = [self.store.find(self.key(*request)) for request in requests]
        missing = [
            [index for index in range(config.eval.episodes) if index not in stored]
            for (config, _), stored in zip(requests, blocks, strict=True)
        ]
        parts = zip(requests, missing, strict=True)
        played = self._play([(*request, indices) for request, indices in parts if indices])
        with self._progress(label, len(requests)) as report, closing(played):
            for at, (request, stored) in enumerate(zip(requests, blocks, strict=True)):
                if missing[at]:
                    rows = self._kept(*request, missing[at], next(played))
                    stored |= {row["episode"]: row for row in rows}
                if any(index not in stored for index in missing[at]):
                    return
                yield Episodes(tuple(stored[index] for index in range(request[0].eval.episodes)))
                report(at + 1)

    def _play(
        self,
        requests: Sequence[tuple[EvalConfig, PolicySource, Sequence[int]]],
        report_search: Callable[[float], None] = lambda fraction: None,
        *,
        record: bool = False,
    ) -> Generator[Iterator[Row], None, None]:
        """Yield the rows of each request, which must be taken before the next request's.

        Several processes share all requests at once. After a stop, there are fewer rows.
        """

        def here(config: EvalConfig, source: PolicySource, indices: Sequence[int]) -> Iterator[Row]:
            runner = None
            for index in indices:
                self.interrupted = self.interrupted or self._stop()
                if self.interrupted:
                    return
                seed = config.eval.seed
                with naming_plugins():  # a policy whose plugin fails is left out by its name
                    runner = runner or EpisodeRunner(
                        *(config, source, seed, report_search),
                        record=record,
                        training=self._training,
                    )
                    row = runner.play(index)
                yield row

        def elsewhere(count: int) -> Iterator[Row]:
            for _ in range(count):
                if self.interrupted or (self._stop() and not waiting[0][2].done()):
                    self.interrupted = True
                    return
                yield _result(pool, *waiting.popleft())

        # A lone process plays here, since a worker would have to start first.
        jobs = requests[0][0].eval.jobs
        if jobs == 1 or sum(len(indices) for *_, indices in requests) == 1:
            yield from (here(*request) for request in requests)
            return
        if self._pool is not None and self._pool.count != jobs:
            self.__exit__()
        pool = self._pool = self._pool or worker_pool(jobs)
        # All requests are submitted at once, so that no worker waits between two of them.
        waiting: deque[tuple[Task, int, Future[Row]]] = deque()
        for config, source, indices in requests:
            task = Task.of(config, source, record=record, training=self._training)
            waiting += ((task, i, pool.submit(_play_in_worker, task, i)) for i in indices)
        try:
            for *_, indices in requests:
                yield elsewhere(len(indices))
        finally:  # after a failure, another policy's episodes come next
            for *_, job in waiting:
                job.cancel()

    def _kept(
        self, config: EvalConfig, source: PolicySource, missing: Sequence[int], rows: Iterator[Row]
    ) -> Iterator[Row]:
        """Yield the rows, and store them block by block; the last block even if it is cut off."""
        key = self.key(config, source)
        stored = self.store.find(key)
        lacking = [index for index in missing if index not in stored]
        ends = [block[-1] for block in blocks(lacking, config.eval.cell)]
        waiting: list[Row] = []
        count = 0

        def keep() -> None:
            part = [row for row in waiting if row["episode"] not in stored]
            waiting.clear()
            if part:
                require_unchanged(source, key.policy.digest)
                self.store.add(key, part)

        # A run that is still trained may change its file, and episodes of two policies must not
        # mix.
        require_unchanged(source, key.policy.digest)
        try:
            for row in rows:
                waiting.append(row)
                count += 1
                if row["episode"] in ends:
                    keep()
                yield row
        except NOT_A_POLICYS:
            raise
        except FlipperctlError as error:
            first = missing[count]
            self.store.fail(key, first, next((end for end in ends if end >= first), first), error)
            raise
        finally:
            keep()

    def play_over_ray(self, requests: Sequence[Request], address: str) -> None:
        """Let a Ray cluster play every block that the store lacks, in any order.

        The evaluation then plays itself what the cluster could not.

        Raises:
            WorkerDiffersError: a worker would compute with other code or files.
        """
        # Each missing block once, though several requests may have it
        wanted: dict[tuple[str, int], tuple[StoreKey, Task, list[int]]] = {}
        for config, source in requests:
            with suppress(FlipperctlError):
                key, task = self.key(config, source), Task.of(config, source)
                for block in self.missing(config, source):
                    wanted.setdefault((key.text, block[0]), (key, task, block))
        if not wanted:
            return
        with cluster.connected(address, "eval.ray", requests[0][0].eval.jobs):
            count = min(len(wanted), max(1, cluster.cpus()[1]))
            with closing(worker_pool(count, cluster.Hosts(count).start)) as pool:
                running = {
                    pool.submit(play_block, task, block, key.policy.digest): (key, len(block))
                    for key, task, block in wanted.values()
                }
                played, total = 0, sum(size for _, size in running.values())
                with self._progress("blocks over Ray", total) as report:
                    while running and not self._stop():
                        # Blocks are stored in the order in which they come; those that failed are
                        # played here.
                        for future in wait(running, POLL, FIRST_COMPLETED).done:
                            key, size = running.pop(future)
                            error = future.exception()
                            if isinstance(error, WorkerDiffersError):
                                raise error
                            if error is not None:
                                text = "Ray: %d episodes are played here, since %s"
                                _log.warning(text, size, error_line(error))
                                continue
                            self.store.add(key, future.result())
                            played += size
                            report(played)


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
    return WorkerPool(count, _start_worker, (Statement.of_code(),), start, ["torch"])


_runner: tuple[int, EpisodeRunner] | None = None  # the newest task's, one per worker process


def _start_worker(code: Statement) -> None:
    """Compute with one thread, and with the ``code`` of the process that asks."""
    import torch

    torch.set_num_threads(1)
    code.enter()


def _worker_runner(task: Task) -> EpisodeRunner:
    """Return the runner of a task in a worker process, built with its first episode."""
    global _runner
    if _runner is None or _runner[0] != task.number:
        task.inputs.enter()
        config = parse(EnvConfig, task.config)
        runner = EpisodeRunner(
            config, task.source, task.seed, record=task.record, training=task.training
        )
        _runner = task.number, runner
    return _runner[1]


def _play_in_worker(task: Task, index: int) -> Row:
    return _worker_runner(task).play(index)


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
