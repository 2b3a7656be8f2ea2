"""A pool of worker processes that replaces those that die.

In: functions and their arguments. Out: futures of their results. Calls wait in one queue; each free
worker takes the next one, so that a long call delays no other. Each worker is a process pool of one
from the standard library, so a process that dies fails only its current call.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import resource_tracker
from queue import LifoQueue
from types import ModuleType
from typing import Any

from flipperctl.errors import FlipperctlError

_ACTOR = "flipperctl.rollout.actor"
_STOPS = (signal.SIGINT, signal.SIGTERM)
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
        several = count > 1 and "forkserver" in multiprocessing.get_all_start_methods()
        context = multiprocessing.get_context("forkserver" if several else "spawn")
        known = multiprocessing.get_all_start_methods()
        if multiprocessing.get_start_method(allow_none=True) not in (None, *known):
            # A joblib worker has its own start method, which its children do not know.
            multiprocessing.set_start_method("spawn", force=True)
        if several:
            context.set_forkserver_preload([_ACTOR, "flipperctl.sim.planar.compiled"])

        given = dict(os.environ), initializer, arguments

        def create() -> ProcessPoolExecutor:
            return ProcessPoolExecutor(1, context, _initialize_process, given)

        self._workers = [_Worker(number, create) for number in range(count)]
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

    _starting = threading.Lock()  # processes are started one at a time

    def __init__(self, number: int, create: Callable[[], ProcessPoolExecutor]) -> None:
        self._number, self._create = number, create
        self._executor = create()
        self._deaths = 0
        self._busy = self._closed = False

    def run(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Call ``function`` in the process; raise as described in ``WorkerPool.submit``."""
        try:
            value = self._submit(function, arguments).result()
        except BrokenProcessPool as error:
            self._deaths += 1
            if self._deaths >= _MAX_DEATHS:
                raise FlipperctlError(
                    f"worker process {self._number} died {_MAX_DEATHS} times in a row, the last "
                    "time in its first job; is the memory full?"
                ) from error
            raise WorkerDiedError(f"worker process {self._number} died") from error
        finally:
            self._busy = False
        self._deaths = 0
        return value

    def _submit(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Future[Any]:
        """Send the call to the process, or to a new one if it has died since its last call."""
        with self._starting, _blocked_stops(), _without_script():
            if self._closed:
                raise WorkerDiedError(f"worker process {self._number} was stopped")
            self._busy = True
            try:
                return self._executor.submit(function, *arguments)
            except BrokenProcessPool:
                self._executor.shutdown(wait=False)
                self._executor = self._create()
                return self._executor.submit(function, *arguments)

    def process_ids(self) -> list[int]:
        """Return the identifier of the process, if it has started."""
        return list(self._executor._processes or {})

    def close(self) -> None:
        """Stop the process, even during a call."""
        with self._starting:
            self._closed = True
        if self._busy:
            for process in list((self._executor._processes or {}).values()):
                process.kill()
        self._executor.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def _blocked_stops() -> Iterator[None]:
    """Block SIGINT and SIGTERM while a worker starts.

    The process inherits the block, so that Ctrl-C, which reaches every process of the run in a
    terminal, does not interrupt its imports.
    """
    if not hasattr(signal, "pthread_sigmask"):  # on Windows
        yield
        return
    resource_tracker.ensure_running()  # starting it later would unblock the signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _STOPS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _without_script() -> Iterator[None]:
    """Keep a worker that starts from running the script of this process once more.

    It needs nothing of the script, which would train or evaluate again in each worker.
    """
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _initialize_process(
    environment: dict[str, str], initializer: Callable[..., None], arguments: tuple[Any, ...]
) -> None:
    os.environ.clear()  # a fork server keeps that of its start, with the plugins of then
    os.environ.update(environment)
    with contextlib.suppress(ValueError):  # not in the main thread
        for number in _STOPS:  # the main process handles them and stops its workers
            signal.signal(number, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):  # not on Windows
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _STOPS)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_with_parent, args=(parent,), daemon=True).start()
    initializer(*arguments)


def _exit_with_parent(parent: Any) -> None:
    """Wait for the end of the parent process, then end this one."""
    parent.join()
    os._exit(1)
