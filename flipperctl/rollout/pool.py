"""A pool of worker processes that replaces those that die.

In: functions and their arguments. Out: what the functions return. Each worker is a process pool of
one from the standard library, so a process that dies ends nothing but the call that it works on.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import resource_tracker
from typing import Any

from flipperctl.errors import FlipperctlError

_ACTOR = "flipperctl.rollout.actor"
_STOPS = (signal.SIGINT, signal.SIGTERM)
_MAX_DEATHS = 3
"""Deaths of a worker, without a result in between, after which the pool fails."""


class WorkerDiedError(FlipperctlError):
    """The process that worked on a call died."""


@dataclass
class PendingCall:
    """A function call that was submitted to a worker."""

    worker: int
    """Index of the worker."""
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    future: Future[Any]


class WorkerPool:
    """``count`` processes, each initialised by ``initializer(*arguments)``."""

    def __init__(
        self, count: int, initializer: Callable[..., None], arguments: tuple[Any, ...]
    ) -> None:
        self.count = count
        # A fork server imports torch once for all workers; for one worker it would only add to
        # the memory.
        several = count > 1 and "forkserver" in multiprocessing.get_all_start_methods()
        self._context = multiprocessing.get_context("forkserver" if several else "spawn")
        known = multiprocessing.get_all_start_methods()
        if multiprocessing.get_start_method(allow_none=True) not in (None, *known):
            # A worker of joblib has a start method of its own, which its children do not know.
            multiprocessing.set_start_method("spawn", force=True)
        if several:
            self._context.set_forkserver_preload([_ACTOR, "flipperctl.sim.planar.compiled"])
        self._initializer = (initializer, arguments)
        self._executors = [self._executor() for _ in range(count)]
        self._deaths = [0] * count
        self._calls: list[deque[PendingCall]] = [deque() for _ in range(count)]

    def _executor(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(1, self._context, _initialize_process, self._initializer)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> PendingCall:
        """Call ``function(*arguments)`` in the worker with the fewest pending calls."""
        worker = min(range(self.count), key=lambda index: len(self._calls[index]))
        future = self._submit_to(worker, function, arguments)
        call = PendingCall(worker, function, arguments, future)
        self._calls[worker].append(call)
        return call

    def _submit_to(
        self, worker: int, function: Callable[..., Any], arguments: tuple[Any, ...]
    ) -> Future[Any]:
        try:
            with _holding_stops():
                return self._executors[worker].submit(function, *arguments)
        except BrokenProcessPool as error:  # the process died after its last call
            failed: Future[Any] = Future()
            failed.set_exception(error)
            return failed

    def result(self, call: PendingCall) -> Any:
        """Wait for a call and return what its function returned.

        Raises:
            WorkerDiedError: the process of the call died; a new one has taken its place and runs
                the calls that were submitted after this one.
            FlipperctlError: the process has died too often.
        """
        try:
            value = call.future.result()
        except BrokenProcessPool as error:
            self._replace(call)
            raise WorkerDiedError(f"worker process {call.worker} died") from error
        finally:
            self._calls[call.worker].remove(call)
        self._deaths[call.worker] = 0
        return value

    def _replace(self, call: PendingCall) -> None:
        """Replace the process that died during ``call``; submit its other calls again."""
        worker = call.worker
        self._deaths[worker] += 1
        if self._deaths[worker] >= _MAX_DEATHS:
            raise FlipperctlError(
                f"worker process {worker} died {_MAX_DEATHS} times in a row, the last time in "
                "its first job; is the memory full?"
            )
        self._executors[worker].shutdown(wait=False)
        self._executors[worker] = self._executor()
        for other in self._calls[worker]:
            if other is not call and (not other.future.done() or other.future.exception()):
                other.future = self._submit_to(worker, other.function, other.arguments)

    def process_ids(self) -> list[int]:
        """Return the process identifiers of the workers that run."""
        return [pid for executor in self._executors for pid in (executor._processes or {})]

    def kill(self) -> None:
        """Kill all processes in the middle of what they do; the pool can only be closed then."""
        for executor in self._executors:
            for process in list((executor._processes or {}).values()):
                process.kill()

    def close(self) -> None:
        """Stop all processes, each after the call that it works on."""
        for executor in self._executors:
            executor.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def _holding_stops() -> Iterator[None]:
    """Hold back what stops a run while a process is started.

    The process inherits that, and its imports are not interrupted: Ctrl-C in a terminal reaches
    every process of the run.
    """
    if not hasattr(signal, "pthread_sigmask"):  # on Windows
        yield
        return
    resource_tracker.ensure_running()  # whose start would let the signals through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _STOPS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _initialize_process(initializer: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    with contextlib.suppress(ValueError):  # not in the main thread
        for number in _STOPS:  # the main process handles them, and ends its workers
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
