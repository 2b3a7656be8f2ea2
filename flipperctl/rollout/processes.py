"""Worker processes that are replaced when they die, and the actors in them.

Each worker is a process pool of one from the standard library: a dead process then takes down
nothing but itself.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from safetensors.numpy import load_file, save_file

from flipperctl.errors import FlipperctlError
from flipperctl.rollout.episode import Row
from flipperctl.rollout.values import PendingEvaluation, Rollout, RolloutRequest, Weights

_ACTOR = "flipperctl.rollout.actor"
_DEATHS = 3
"""A worker that dies this often without a result in between is given up."""


class WorkerDiedError(FlipperctlError):
    """The process died that worked on a job."""


@dataclass
class Job:
    """A call handed to a worker."""

    worker: int
    task: Callable[..., Any]
    arguments: tuple[Any, ...]
    future: Future[Any]


class Workers:
    """``count`` processes, each begun with ``begin(*arguments)``."""

    def __init__(self, count: int, begin: Callable[..., None], arguments: tuple[Any, ...]) -> None:
        self.count = count
        # A fork server imports torch once for all workers; for one worker it would only add to
        # the memory.
        several = count > 1 and "forkserver" in multiprocessing.get_all_start_methods()
        self._context = multiprocessing.get_context("forkserver" if several else "spawn")
        known = multiprocessing.get_all_start_methods()
        if multiprocessing.get_start_method(allow_none=True) not in (None, *known):
            # A worker of joblib's has one of its own, which its children would not know.
            multiprocessing.set_start_method("spawn", force=True)
        if several:
            self._context.set_forkserver_preload([_ACTOR, "flipperctl.sim.planar.compiled"])
        self._begin = (begin, arguments)
        self._pools = [self._pool() for _ in range(count)]
        self._deaths = [0] * count
        self._jobs: list[deque[Job]] = [deque() for _ in range(count)]

    def _pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(1, self._context, _start, self._begin)

    def submit(self, task: Callable[..., Any], *arguments: Any) -> Job:
        """Call ``task(*arguments)`` in the worker that has the least to do."""
        worker = min(range(self.count), key=lambda index: len(self._jobs[index]))
        job = Job(worker, task, arguments, self._hand_over(worker, task, arguments))
        self._jobs[worker].append(job)
        return job

    def _hand_over(
        self, worker: int, task: Callable[..., Any], arguments: tuple[Any, ...]
    ) -> Future[Any]:
        try:
            return self._pools[worker].submit(task, *arguments)
        except BrokenProcessPool as error:  # it died while it had nothing to do, or since
            failed: Future[Any] = Future()
            failed.set_exception(error)
            return failed

    def result(self, job: Job) -> Any:
        """Wait for what the job returns.

        Raises:
            WorkerDiedError: its process died; another has taken its place, with the jobs behind.
        """
        try:
            value = job.future.result()
        except BrokenProcessPool as error:
            self._replace(job)
            raise WorkerDiedError(f"worker process {job.worker} died") from error
        finally:
            self._jobs[job.worker].remove(job)
        self._deaths[job.worker] = 0
        return value

    def _replace(self, job: Job) -> None:
        worker = job.worker
        self._deaths[worker] += 1
        if self._deaths[worker] >= _DEATHS:
            raise FlipperctlError(
                f"worker process {worker} died {_DEATHS} times in a row, the last time in "
                "its first job; is the memory full?"
            )
        self._pools[worker].shutdown(wait=False)
        self._pools[worker] = self._pool()
        for other in self._jobs[worker]:
            if other is not job and (not other.future.done() or other.future.exception()):
                other.future = self._hand_over(worker, other.task, other.arguments)

    def processes(self) -> list[int]:
        """The process numbers of the workers that run."""
        return [pid for pool in self._pools for pid in (pool._processes or {})]

    def close(self) -> None:
        """Stop all processes, each behind the job that it works on."""
        for pool in self._pools:
            pool.shutdown(wait=True, cancel_futures=True)


def _start(begin: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    with contextlib.suppress(ValueError):  # not in the main thread
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the main process' business
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_leave_with, args=(parent,), daemon=True).start()
    begin(*arguments)


def _leave_with(parent: Any) -> None:
    parent.join()
    os._exit(1)


class ProcessWorkers:
    """Actors in ``count`` processes; rollouts come in the order of the requests."""

    def __init__(self, count: int, config: dict[str, Any], plugin_paths: list[str]) -> None:
        self.count = count
        self.capacity = 2 * count  # one is waiting while the other is played
        self._workers = Workers(count, _begin, (config, plugin_paths))
        self._sent: deque[tuple[RolloutRequest, Job]] = deque()
        # Weights go through files: a pool whose process dies while a long message to it is under
        # way would hold up the interpreter's exit (CPython issue 94777, before Python 3.12).
        self._folder = TemporaryDirectory(prefix="flipperctl-", ignore_cleanup_errors=True)
        self._files: dict[int, Path] = {}

    def send(self, request: RolloutRequest) -> None:
        """Send a request to the worker that has the least to do."""
        if request.version not in self._files:
            self._files[request.version] = self._write(f"request{request.version}", request.weights)
        path = self._files[request.version]
        slim = replace(request, weights={})
        self._sent.append((request, self._workers.submit(_play, slim, path)))

    def take(self) -> tuple[RolloutRequest, Rollout | None]:
        """The oldest request, and its episode."""
        request, job = self._sent.popleft()
        try:
            return request, self._workers.result(job)
        except WorkerDiedError:
            return request, None
        finally:
            in_use = {waiting.version for waiting in self.outstanding()}
            for version in self._files.keys() - in_use:
                self._files.pop(version).unlink()

    def evaluate(self, weights: Weights, parts: Sequence[Sequence[int]]) -> list[PendingEvaluation]:
        """Send each part of the seeds to the worker that has the least to do."""
        path = self._write("evaluated", weights)
        jobs = [self._workers.submit(_evaluate, path, part) for part in parts]
        return [partial(self._evaluated, job) for job in jobs]

    def _write(self, name: str, weights: Weights) -> Path:
        path = Path(self._folder.name) / f"{name}.safetensors"
        save_file(dict(weights), path)
        return path

    def _evaluated(self, job: Job) -> list[Row] | None:
        try:
            rows: list[Row] = self._workers.result(job)
        except WorkerDiedError:
            return None
        return rows

    def outstanding(self) -> list[RolloutRequest]:
        """Return the requests that were sent and not taken."""
        return [request for request, _ in self._sent]

    def close(self) -> None:
        """Stop the processes."""
        self._workers.close()
        self._folder.cleanup()


_actor: Any = None  # one a worker process


def _begin(config: dict[str, Any], plugin_paths: list[str]) -> None:
    global _actor
    from flipperctl.rollout.actor import StartedActor

    _actor = StartedActor(config, plugin_paths)


def _play(request: RolloutRequest, weights: Path) -> Rollout:
    played: Rollout = _actor.play(request, load_file(weights))
    return played


def _evaluate(weights: Path, seeds: Sequence[int]) -> list[Row]:
    rows: list[Row] = _actor.evaluate(load_file(weights), seeds)
    return rows
