"""A pool of workers that run calls, each one at a time, and are replaced when they die.

In: functions and their arguments. Out: futures of their results. Calls wait in one queue; each free
worker takes the next one, so that a long call delays no other. Workers are actors on a Ray cluster
(``cluster``) or processes of this machine. Each process has a ``ProcessPoolExecutor``, since an
executor of several loses the calls of all when one of them dies.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import ProcessPoolExecutor
from multiprocessing import connection, process, resource_tracker
from multiprocessing.process import BaseProcess
from pathlib import Path
from queue import Empty, SimpleQueue
from tempfile import TemporaryDirectory, mkstemp
from typing import Any, Protocol, cast

from flipperctl.errors import FlipperctlError
from flipperctl.plugging import guard, plugins
from flipperctl.process.entry import STOPS

Stop = Callable[[], bool]
"""Returns whether the user has asked the run to stop."""
POLL = 0.1
"""Longest time between two calls of ``Stop`` during a wait for workers [s]."""
_MAX_DEATHS = 3
"""Number of successive deaths of a worker after which its calls fail."""
_PRELOAD = "flipperctl.rollout.preloaded"
"""What the fork server imports once for all its workers."""
_LONG = 2**15
"""Length from which messages go through files [B]. A process that dies while a longer one is in a
pipe would block the interpreter's exit (CPython issue 94777, before Python 3.12)."""


class WorkerDiedError(FlipperctlError):
    """The process that worked on a call died."""


class DiedError(Exception):
    """A host ended before it answered; the text says how."""


class Host(Protocol):
    """A process that answers one call at a time: a ``ProcessHost``, or an actor of ``cluster``."""

    @property
    def alive(self) -> bool:
        """Whether it still lives, as far as is known before its next call."""

    def call(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Return ``function(*arguments)``, or raise what it raised, or ``DiedError``."""

    def end(self) -> str:
        """End it, even within a call; return in words how it ended."""


class WorkerPool:
    """``count`` workers, each initialised by ``initializer(*arguments)``.

    A process of this machine starts with the first call for which no other one is free. Workers
    elsewhere, by ``start``, start at once and take calls as soon as they have started.
    """

    def __init__(
        self,
        count: int,
        initializer: Callable[..., None],
        arguments: tuple[Any, ...],
        start: Callable[[], Host] | None = None,
        modules: Sequence[str] = (),
    ) -> None:
        """``modules``: what a server imports for its workers, beside what all of them need."""
        self.count = count
        # A server imports once for all workers; for one worker it would only add to memory.
        method = "forkserver" if count > 1 else "spawn"
        self._begin = start or (lambda: ProcessHost(method, modules))
        self._first = initializer, arguments
        self._calls: SimpleQueue[tuple[Future[Any], Any, Any] | None] = SimpleQueue()
        self._hosts: dict[int, Host] = {}
        self._threads: list[threading.Thread] = []  # one waits for each worker
        self._lock = threading.Lock()  # of all fields
        self._closed, self._unfinished = False, 0
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
            number = len(self._threads)
            self._threads.append(threading.Thread(target=self._work, args=(number,), daemon=True))
            self._threads[-1].start()

    def _work(self, number: int) -> None:
        """Let a worker take one call after the other; runs in its own thread."""
        deaths = 0
        problem: BaseException | None = None

        # What a step raises is raised again where the call's future is awaited.
        def attempt(step: Callable[..., Any], *arguments: Any) -> Any:
            nonlocal deaths, problem
            try:
                problem = None
                return step(number, *arguments)
            except DiedError as error:
                deaths += 1
                problem = self._death(number, deaths, str(error))
            except BaseException as error:  # noqa: BLE001 - raised where the result is awaited
                problem = error

        while True:
            # A worker that dies before it is ready costs no call: the next one begins with another.
            attempt(self._ready)
            if (call := self._calls.get()) is None:
                return
            future, *work = call
            # A call that was cancelled while it waited is skipped.
            if not future.set_running_or_notify_cancel():
                continue
            value = None
            # A worker that only died can be replaced; one that cannot start fails the call.
            if problem is None or isinstance(problem, WorkerDiedError):
                value = attempt(self._call, *work)
                deaths = deaths if problem else 0
            with self._lock:
                self._unfinished -= 1
            if problem is None:
                future.set_result(value)
            else:
                future.set_exception(problem)

    def _call(self, number: int, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        return self._ready(number).call(function, arguments)

    def _ready(self, number: int) -> Host:
        """Return the host of a worker; a new one if there is none or it has died in between."""
        # Reuse the host that lives; only its own thread replaces it.
        with self._lock:
            host = self._hosts.get(number)
            if self._closed:
                raise DiedError("it was stopped")
        if host is not None and host.alive:
            return host
        if host is not None:
            self._discard(number)
        # Resources such as processes or memory may be short on this machine.
        try:
            host = self._begin()
        except OSError as error:
            raise FlipperctlError(
                f"a worker process cannot start: {os.strerror(error.errno or 0)}; without any, "
                "--jobs 1 evaluates and train.mode=exact trains"
            ) from error
        # The pool may have been closed while the host was starting: then it ends here.
        with self._lock:
            self._hosts[number] = host
            closed = self._closed
        if closed:
            raise DiedError(self._discard(number))
        # The first call initialises the worker: its failures are not those of the user's call.
        try:
            host.call(*self._first)
        except DiedError:
            raise
        except FlipperctlError:
            self._discard(number)
            raise
        except BaseException as error:
            self._discard(number)
            text = f"worker process {number} cannot start: {guard.error_line(error)}"
            raise FlipperctlError(text) from error
        return host

    def _discard(self, number: int) -> str:
        """End the host of a worker and forget it; return in words how it ended."""
        with self._lock:
            host = self._hosts.pop(number, None)
        return "it was stopped" if host is None else f"it {host.end()}"

    def _death(self, number: int, deaths: int, text: str) -> FlipperctlError:
        """Return the error of a call whose process has died."""
        how = text or self._discard(number)
        self._discard(number)
        if deaths < _MAX_DEATHS or self._closed:
            return WorkerDiedError(f"worker process {number} died: {how}")
        return FlipperctlError(
            f"worker process {number} died {_MAX_DEATHS} times in a row; the last time, {how} "
            '(a script that begins processes needs: if __name__ == "__main__":)'
        )

    def close(self) -> None:
        """Stop all processes at once; calls that have not ended are lost."""
        # Waiting calls are cancelled, running ones end with their processes.
        with contextlib.suppress(Empty):
            while True:
                if (call := self._calls.get_nowait()) is not None:
                    call[0].cancel()
        with self._lock:
            self._closed, hosts = True, list(self._hosts.values())
        for host in hosts:
            host.end()
        # A None for each thread ends its loop.
        for _ in self._threads:
            self._calls.put(None)
        for thread in self._threads:
            thread.join()


class _CallError(Exception):
    """The traceback of an error in a worker process."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


class _Context:
    """A start method of ``multiprocessing``, which keeps the process that an executor starts."""

    process: BaseProcess

    def __init__(self, method: str, modules: Sequence[str]) -> None:
        self._context: Any = multiprocessing.get_context(method)
        if method == "forkserver":  # one that runs already keeps what it has
            self._context.set_forkserver_preload([*modules, _PRELOAD])

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def Process(self, **settings: Any) -> BaseProcess:  # noqa: N802 - as the executor asks
        self.process = process = self._context.Process(**settings)
        return cast("BaseProcess", process)


class ProcessHost:
    """A process that answers one call at a time."""

    def __init__(self, method: str = "forkserver", modules: Sequence[str] = ()) -> None:
        """``method``: a start method of ``multiprocessing``, ``forkserver`` or ``spawn``.

        ``modules``: see ``WorkerPool``.
        """
        self._folder = TemporaryDirectory(prefix="flipperctl-", ignore_cleanup_errors=True)
        self._lock, self._ending = threading.Lock(), ""
        self._context = _Context(method, modules)
        self._executor = ProcessPoolExecutor(1, cast("Any", self._context), _begin_worker)
        # An executor starts its process with its first call, which therefore is made here.
        with _starting():
            self._executor.submit(int)

    @property
    def pid(self) -> int:
        """Identifier of the process."""
        return self._context.process.pid or 0

    @property
    def alive(self) -> bool:
        """Whether the process lives."""
        return not connection.wait([self._context.process.sentinel], timeout=0)

    def call(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Return ``function(*arguments)`` of the process, or raise what it raised there."""
        packed = _pack((function, arguments), self._folder.name)  # an error in it is the caller's
        # A broken executor means that the process died; what the call raised comes as an answer.
        try:
            answer = self._executor.submit(_answer, packed, self._folder.name).result()
        except RuntimeError as error:  # broken, or shut down
            raise DiedError from error
        done, value, text = _unpack(answer)
        if done:
            return value
        raise value from _CallError(text)

    def end(self) -> str:
        """End the process, even within a call; return in words how it ended."""
        with self._lock:
            if not self._ending:
                self._context.process.kill()
                self._executor.shutdown()
                self._context.process.join()
                self._ending = _ending(self._context.process.exitcode)
                self._folder.cleanup()
            return self._ending


_start_lock = threading.Lock()


@contextlib.contextmanager
def _starting() -> Iterator[None]:
    """Start processes that import nothing from the working directory, and no signal interrupts."""
    with _start_lock:
        # Workers inherit this environment; the parent's own is restored at the end.
        before = os.environ.get("PYTHONSAFEPATH")
        os.environ["PYTHONSAFEPATH"] = "1"
        resource_tracker.ensure_running()  # which unblocks signals
        # A child inherits the blocked signals until it ignores them itself (``_begin_worker``).
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            del os.environ["PYTHONSAFEPATH"]
            os.environ.update({} if before is None else {"PYTHONSAFEPATH": before})


def _begin_worker() -> None:
    """Leave signals to the main process, which stops its workers, and end with it."""
    for number in STOPS:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)
    threading.Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    # A worker whose parent was killed would wait for calls for ever.
    parent.join()
    os._exit(1)


def _answer(call: bytes | Path, folder: str) -> bytes | Path:
    """Run a call in a worker process; return its packed answer."""
    try:
        function, arguments = _unpack(call)
        with guard.naming_plugins():  # since a pickled error has no traceback
            return _pack((True, function(*arguments), ""), folder)
    except BaseException as error:  # noqa: BLE001 - raised in the main process
        text = traceback.format_exc()
        # An exception that does not survive pickling is replaced, since the parent must get one.
        try:
            pickle.loads(pickle.dumps(error))  # noqa: S301 - its own constructor may refuse
        except Exception:  # noqa: BLE001 - of the exception's class
            error = RuntimeError(f"{type(error).__name__}: {error}")
        return _pack((False, error, text), folder)
    finally:
        for stream in (sys.stdout, sys.stderr):  # this process may be ended at any time
            with contextlib.suppress(Exception):
                stream.flush()


def _pack(message: object, folder: str) -> bytes | Path:
    """Return a pickled message; of a long one the file in ``folder`` that holds it."""
    data = pickle.dumps(message)
    if len(data) < _LONG:
        return data
    descriptor, name = mkstemp(dir=folder)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
    return Path(name)


def _unpack(packed: bytes | Path) -> Any:
    if isinstance(packed, bytes):
        return pickle.loads(packed)  # noqa: S301 - from our own process
    data = packed.read_bytes()
    packed.unlink()
    return pickle.loads(data)  # noqa: S301


def _ending(code: int | None) -> str:
    """Return how a process ended, by its exit code."""
    if code is None:
        return "ended"
    if code >= 0:
        return f"ended with exit code {code}"
    name = signal.Signals(-code).name
    return f"was killed by {name}" + ("; is the memory full?" if -code == signal.SIGKILL else "")


def import_path() -> list[str]:
    """Return the folders in which this process looks for modules, in their order."""
    begun_in = Path(getattr(process, "ORIGINAL_DIR", None) or "")  # relative ones are seen from it
    return [str(begun_in / entry) for entry in sys.path]


def python_environment() -> dict[str, str]:
    """Return the environment of a Python program that imports from where this process does."""
    imports = {"PYTHONSAFEPATH": "1", "PYTHONPATH": os.pathsep.join(import_path())}
    return {**os.environ, **imports, plugins.VARIABLE: os.pathsep.join(plugins.configured_paths())}
