"""A pool of worker processes that replaces those that die.

In: functions and their arguments. Out: futures of their results. Calls wait in one queue; each free
worker takes the next one, so that a long call delays no other. A process that dies fails only its
current call.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from queue import LifoQueue
from typing import Any

from flipperctl import guard
from flipperctl.errors import FlipperctlError
from flipperctl.rollout.children import Child, ChildDiedError, fork, spawn

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
