"""A pool of workers that run calls, each one at a time, and are replaced when they die.

In: functions and their arguments. Out: futures of their results. Calls wait in one queue; each free
worker takes the next one, so that a long call delays no other. Workers are processes of this
machine (``children``) or actors on a Ray cluster (``cluster``).
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any, Protocol

from flipperctl import guard
from flipperctl.errors import FlipperctlError
from flipperctl.rollout.children import DiedError, fork, spawn

Stop = Callable[[], bool]
"""Returns whether the user has asked the run to stop."""
POLL = 0.1
"""Longest time between two calls of ``Stop`` during a wait for workers [s]."""
_MAX_DEATHS = 3
"""Number of successive deaths of a worker after which its calls fail."""


class WorkerDiedError(FlipperctlError):
    """The process that worked on a call died."""


class Host(Protocol):
    """A process that answers one call at a time."""

    @property
    def idle(self) -> bool:
        """Whether it still lives and waits for a call."""

    def call(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Return ``function(*arguments)``, or raise what it raised, or ``DiedError``."""

    def end(self, *, kill: bool) -> str:
        """End it, even within a call if ``kill``; return in words how it ended."""


class WorkerPool:
    """``count`` workers, each initialised by ``initializer(*arguments)``.

    A process starts with the first call for which no other one is free; what ``start`` starts
    elsewhere starts at once, and takes calls as soon as it has started.
    """

    def __init__(
        self,
        count: int,
        initializer: Callable[..., None],
        arguments: tuple[Any, ...],
        start: Callable[[], Host] | None = None,
    ) -> None:
        self.count = count
        # A fork server imports torch once for all workers; for one worker it would only add to
        # the memory.
        begin = start or (fork if count > 1 else spawn)
        first = initializer, arguments
        self._workers = [_Worker(number, begin, first) for number in range(count)]
        self._calls: SimpleQueue[tuple[Future[Any], Any, Any] | None] = SimpleQueue()
        self._threads: list[threading.Thread] = []  # one waits for each process
        self._lock = threading.Lock()
        self._unfinished = 0
        self._closed = False
        self._start_threads(count if start else 0)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Queue the call ``function(*arguments)``; return its future.

        Calls begin in their order; a call that has not begun can be cancelled. The result of the
        future may raise:

            WorkerDiedError: the process of the call died; a new one takes the next call.
            FlipperctlError: the processes of a worker died too often.
        """
        future: Future[Any] = Future()
        with self._lock:
            self._unfinished += 1
            self._calls.put((future, function, arguments))
            self._start_threads(min(self.count, self._unfinished))
        return future

    def _start_threads(self, count: int) -> None:
        while len(self._threads) < count:
            worker = self._workers[len(self._threads)]
            self._threads.append(threading.Thread(target=self._work, args=(worker,), daemon=True))
            self._threads[-1].start()

    def _work(self, worker: _Worker) -> None:
        """Let a worker take one call after the other; runs in its own thread."""
        worker.prepare()
        while (call := self._calls.get()) is not None:
            future, function, arguments = call
            begun = future.set_running_or_notify_cancel()
            value: Any = None
            problem: BaseException | None = None
            try:
                value = worker.run(function, arguments) if begun else None
            except BaseException as error:  # noqa: BLE001 - raised where the result is awaited
                problem = error
            with self._lock:
                self._unfinished -= 1
            if begun and problem is not None:
                future.set_exception(problem)
            elif begun:
                future.set_result(value)
            worker.prepare()

    def close(self) -> None:
        """Stop all processes at once; calls that have not ended are lost."""
        with suppress(Empty):
            while True:
                if (call := self._calls.get_nowait()) is not None:
                    call[0].cancel()
        for worker in self._workers:
            worker.close()
        for _ in self._threads:
            self._calls.put(None)
        for thread in self._threads:
            thread.join()


class _Worker:
    """A process that runs one call at a time, replaced when it dies."""

    def __init__(
        self,
        number: int,
        start: Callable[[], Host],
        first: tuple[Callable[..., None], tuple[Any, ...]],
    ) -> None:
        self._number, self._start, self._first = number, start, first
        self._host: Host | None = None
        self._deaths = 0
        self._problem: FlipperctlError | None = None
        self._lock = threading.Lock()  # held while a process starts or is ended
        self._busy = self._closed = False

    def prepare(self) -> None:
        """Have a process ready for the next call, which raises the error of its start."""
        try:
            self._ready()
        except DiedError as error:
            self._problem = self._death(error)
        except FlipperctlError as error:
            self._problem = error
        finally:
            self._busy = False

    def run(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Call ``function`` in the process; raise as described in ``WorkerPool.submit``."""
        problem, self._problem = self._problem, None
        if problem is not None:
            raise problem
        try:
            value = self._ready().call(function, arguments)
        except DiedError as error:
            raise self._death(error) from error
        finally:
            self._busy = False
        self._deaths = 0
        return value

    def _ready(self) -> Host:
        """Return the process, or a new one if there is none or it has died since its last call."""
        with self._lock:
            if self._closed:
                raise WorkerDiedError(f"worker process {self._number} was stopped")
            self._busy = True
            if self._host is not None and self._host.idle:
                return self._host
            self._discard()
            try:
                host = self._host = self._start()
            except OSError as error:
                raise FlipperctlError(
                    f"a worker process cannot start: {os.strerror(error.errno or 0)}; without any, "
                    "--jobs 1 evaluates and train.mode=exact trains"
                ) from error
        try:
            host.call(*self._first)
        except DiedError:
            raise
        except BaseException as error:
            with self._lock:
                self._discard()
            if isinstance(error, FlipperctlError):
                raise
            raise FlipperctlError(
                f"worker process {self._number} cannot start: {guard.error_line(error)}"
            ) from error
        return host

    def _discard(self) -> str:
        """End the process and forget it; return in words how it ended, if there is one."""
        host, self._host = self._host, None
        return "" if host is None else f"it {host.end(kill=True)}"

    def _death(self, error: DiedError) -> FlipperctlError:
        """Return the error of a call whose process has died."""
        with self._lock:
            how = self._discard() or str(error)
        self._deaths += 1
        if self._deaths < _MAX_DEATHS or self._closed:
            return WorkerDiedError(f"worker process {self._number} died: {how}")
        return FlipperctlError(
            f"worker process {self._number} died {_MAX_DEATHS} times in a row; the last time, {how}"
        )

    def close(self) -> None:
        """Stop the process, even during a call."""
        with self._lock:
            self._closed = True
            if self._host is not None:
                self._host.end(kill=self._busy)
