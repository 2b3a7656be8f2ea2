"""A pool of worker processes that replaces those that die, and actors in them.

In: functions and their arguments. Out: futures of their results. Calls wait in one queue; each free
worker takes the next one, so that a long call delays no other. A process that dies fails only its
current call. Actors answer requests in their order (``train.mode=fast``).
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import replace
from pathlib import Path
from queue import LifoQueue
from tempfile import TemporaryDirectory
from typing import Any

from safetensors.numpy import load_file, save_file

from flipperctl import guard
from flipperctl.errors import FlipperctlError
from flipperctl.rollout.children import Child, ChildDiedError, fork, spawn
from flipperctl.rollout.episode import Row
from flipperctl.rollout.values import POLL, Rollout, RolloutRequest, Stop, Weights

_MAX_DEATHS = 3
"""Number of successive deaths of a worker after which its calls fail."""


class WorkerDiedError(FlipperctlError):
    """The process that worked on a call died."""


class WorkerPool:
    """``count`` processes, each initialised by ``initializer(*arguments)``.

    A process starts with the first call for which no other process is free.
    """

    def __init__(
        self, count: int, initializer: Callable[..., None], arguments: tuple[Any, ...]
    ) -> None:
        self.count = count
        # A fork server imports torch once for all workers; for one worker it would only add to
        # the memory.
        start = fork if count > 1 else spawn
        first = initializer, arguments
        self._workers = [_Worker(number, start, first) for number in range(count)]
        self._idle: LifoQueue[_Worker] = LifoQueue()
        for worker in reversed(self._workers):
            self._idle.put(worker)
        self._threads = ThreadPoolExecutor(count)  # one waits for each process

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Queue the call ``function(*arguments)``; return its future.

        Calls begin in their order; a call that has not begun can be cancelled. The result of the
        future may raise:

            WorkerDiedError: the process of the call died; a new one takes the next call.
            FlipperctlError: the processes of a worker died too often.
        """
        return self._threads.submit(self._run, function, arguments)

    def _run(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        worker = self._idle.get()
        try:
            return worker.run(function, arguments)
        finally:
            self._idle.put(worker)

    def process_ids(self) -> list[int]:
        """Return the process identifiers of the workers that run."""
        return [pid for worker in self._workers for pid in worker.process_ids()]

    def close(self) -> None:
        """Stop all processes at once; calls that have not ended are lost."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        for worker in self._workers:
            worker.close()
        self._threads.shutdown()


class _Worker:
    """A process that runs one call at a time, replaced when it dies."""

    def __init__(
        self,
        number: int,
        start: Callable[[], Child],
        first: tuple[Callable[..., None], tuple[Any, ...]],
    ) -> None:
        self._number, self._start, self._first = number, start, first
        self._child: Child | None = None
        self._deaths = 0
        self._lock = threading.Lock()  # held while a process starts or is ended
        self._busy = self._closed = False

    def run(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Call ``function`` in the process; raise as described in ``WorkerPool.submit``."""
        try:
            value = self._ready().call(function, arguments)
        except ChildDiedError as error:
            raise self._death(error) from error
        finally:
            self._busy = False
        self._deaths = 0
        return value

    def _ready(self) -> Child:
        """Return the process, or a new one if there is none or it has died since its last call."""
        with self._lock:
            if self._closed:
                raise WorkerDiedError(f"worker process {self._number} was stopped")
            self._busy = True
            if self._child is not None and self._child.idle:
                return self._child
            self._discard()
            try:
                child = self._child = self._start()
            except OSError as error:
                raise FlipperctlError(
                    f"a worker process cannot start: {os.strerror(error.errno or 0)}; without any, "
                    "--jobs 1 evaluates and train.mode=exact trains"
                ) from error
        try:
            child.call(*self._first)
        except ChildDiedError:
            raise
        except BaseException as error:
            with self._lock:
                self._discard()
            if isinstance(error, FlipperctlError):
                raise
            raise FlipperctlError(
                f"worker process {self._number} cannot start: {guard.error_line(error)}"
            ) from error
        return child

    def _discard(self) -> str:
        """End the process and forget it; return in words how it ended, if there is one."""
        child, self._child = self._child, None
        return "" if child is None else f"it {child.end(kill=True)}"

    def _death(self, error: ChildDiedError) -> FlipperctlError:
        """Return the error of a call whose process has died."""
        with self._lock:
            how = self._discard() or str(error)
        self._deaths += 1
        if self._deaths < _MAX_DEATHS or self._closed:
            return WorkerDiedError(f"worker process {self._number} died: {how}")
        return FlipperctlError(
            f"worker process {self._number} died {_MAX_DEATHS} times in a row; the last time, {how}"
        )

    def process_ids(self) -> list[int]:
        """Return the identifier of the process, if it has started."""
        child = self._child
        return [] if child is None else [child.pid]

    def close(self) -> None:
        """Stop the process, even during a call."""
        with self._lock:
            self._closed = True
            if self._child is not None:
                self._child.end(kill=self._busy)


class ProcessWorkers:
    """Actors in ``count`` processes; rollouts come in the order of the requests."""

    def __init__(self, count: int, config: dict[str, Any], plugin_paths: list[str]) -> None:
        """``config``: a ``TrainConfig`` as plain data."""
        self.capacity = 2 * count  # each worker plays one request while another waits
        self._pool = WorkerPool(count, _create_actor, (config, plugin_paths))
        self._sent: deque[tuple[RolloutRequest, Future[Rollout]]] = deque()
        # Weights go through files: a process that dies while it receives a long message would block
        # the interpreter's exit (CPython issue 94777, before Python 3.12).
        self._folder = TemporaryDirectory(prefix="flipperctl-", ignore_cleanup_errors=True)
        self._files: dict[int, Path] = {}

    def send(self, request: RolloutRequest) -> None:
        """Queue a request for the next free worker."""
        if request.version not in self._files:
            self._files[request.version] = self._write(f"request{request.version}", request.weights)
        path = self._files[request.version]
        light = replace(request, weights={})
        self._sent.append((request, self._pool.submit(_play, light, path)))

    def take(self, stop: Stop) -> tuple[RolloutRequest, Rollout | None] | None:
        """Wait for the oldest request; return it and its rollout, or None if its worker died.

        Returns None alone, and keeps the request, if ``stop`` returns True first.
        """
        request, future = self._sent[0]
        while not wait([future], POLL).done:
            if stop():
                return None
        self._sent.popleft()
        try:
            return request, future.result()
        except WorkerDiedError:
            return request, None
        finally:
            in_use = {waiting.version for waiting in self.outstanding()}
            for version in self._files.keys() - in_use:
                self._files.pop(version).unlink()

    def evaluate(self, weights: Weights, seeds: Sequence[int]) -> list[Future[Row]]:
        """Queue one greedy episode for each seed; they begin in this order."""
        path = self._write("evaluated", weights)
        return [self._pool.submit(_evaluate, path, seed) for seed in seeds]

    def _write(self, name: str, weights: Weights) -> Path:
        path = Path(self._folder.name) / f"{name}.safetensors"
        save_file(dict(weights), path)
        return path

    def outstanding(self) -> list[RolloutRequest]:
        """Return the requests that were sent but not yet taken, oldest first."""
        return [request for request, _ in self._sent]

    def close(self) -> None:
        """Stop the processes and delete their files."""
        self._pool.close()
        self._folder.cleanup()


_actor: Any = None
"""The actor of this worker process."""


def _create_actor(config: dict[str, Any], plugin_paths: list[str]) -> None:
    global _actor
    from flipperctl.rollout.actor import StartedActor

    _actor = StartedActor(config, plugin_paths)


def _play(request: RolloutRequest, weights: Path) -> Rollout:
    rollout: Rollout = _actor.play(request, load_file(weights))
    return rollout


def _evaluate(weights: Path, seed: int) -> Row:
    row: Row = _actor.evaluate(load_file(weights), seed)
    return row
