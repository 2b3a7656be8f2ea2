"""A pool of workers that run calls, each one at a time, and are replaced when they die.

In: functions and their arguments. Out: futures of their results. Calls wait in one queue; each free
worker takes the next one, so that a long call delays no other. Workers are actors on a Ray cluster
(``cluster``) or processes of this machine (``worker``), which import what this process has
imported, from wherever it did. Nothing of this process is changed, neither its environment and
signal mask nor ``multiprocessing``, which the caller may use itself.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from importlib.machinery import ModuleSpec
from multiprocessing import Pipe, process, reduction
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Protocol

from flipperctl import guard, plugins
from flipperctl.errors import FlipperctlError
from flipperctl.rollout import worker as script

Stop = Callable[[], bool]
"""Returns whether the user has asked the run to stop."""
POLL = 0.1
"""Longest time between two calls of ``Stop`` during a wait for workers [s]."""
_MAX_DEATHS = 3
"""Number of successive deaths of a worker after which its calls fail."""


class WorkerDiedError(FlipperctlError):
    """The process that worked on a call died."""


class Host(Protocol):
    """A process that answers one call at a time: a ``Child``, or an actor of ``cluster``."""

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
        # A server imports torch once for all workers; for one worker it would only add to memory.
        begin = start or (fork if count > 1 else spawn)
        first = initializer, arguments
        self._workers = [_Worker(number, begin, first) for number in range(count)]
        self._calls: SimpleQueue[tuple[Future[Any], Any, Any] | None] = SimpleQueue()
        self._threads: list[threading.Thread] = []  # one waits for each process
        self._lock = threading.Lock()
        self._unfinished = 0
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
            begun, problem, value = future.set_running_or_notify_cancel(), None, None
            try:
                value = worker.run(function, arguments) if begun else None
            except BaseException as error:  # noqa: BLE001 - raised where the result is awaited
                problem = error
            with self._lock:
                self._unfinished -= 1
            if problem is not None:
                future.set_exception(problem)
            elif begun:
                future.set_result(value)
            worker.prepare()

    def close(self) -> None:
        """Stop all processes at once; calls that have not ended are lost."""
        with contextlib.suppress(Empty):
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
        """Have a process ready for the next call, which raises the error of its start.

        A process that dies before it is ready costs no call: the next one begins with another.
        """
        try:
            self._ready()
        except DiedError as error:
            problem = self._death(error)
            self._problem = None if isinstance(problem, WorkerDiedError) else problem
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


_PRELOAD = ("flipperctl.rollout.collect", "flipperctl.sim.planar.compiled")
"""What the fork server imports once for all its workers."""


class DiedError(Exception):
    """A child process ended before it answered."""


class _CallError(Exception):
    """The traceback of an error in a child process."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


class Child:
    """A process that answers one call at a time."""

    def __init__(self, pid: int, connection: Connection, wait: Callable[[], int | None]) -> None:
        self.pid, self._connection, self._wait = pid, connection, wait
        self._ending = ""
        self._lock = threading.Lock()
        self._send(_state())

    def call(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Return ``function(*arguments)`` of the process, or raise what it raised there."""
        self._send((function, arguments))
        try:
            answer = self._connection.recv_bytes()
        except (EOFError, OSError) as error:
            raise DiedError from error
        done, value, text = pickle.loads(answer)  # noqa: S301 - from our own process
        if done:
            return value
        raise value from _CallError(text)

    def _send(self, message: object) -> None:
        data = pickle.dumps(message)  # an error in it is the caller's
        with contextlib.suppress(OSError):  # of a process that has ended, which the answer tells
            self._connection.send_bytes(data)

    @property
    def idle(self) -> bool:
        """Whether the process, which has answered all calls, waits for another one."""
        return not self._connection.poll()

    def end(self, *, kill: bool) -> str:
        """End the process, even within a call if ``kill``; return in words how it ended."""
        with self._lock:
            if not self._ending:
                if kill:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(self.pid, signal.SIGKILL)
                self._connection.close()
                self._ending = _ending(self._wait())
            return self._ending


def spawn() -> Child:
    """Start a process."""
    connection, started = _start()
    return Child(started.pid, connection, started.wait)


def fork() -> Child:
    """Start a process that has the learner's modules from a server, which imports them once."""
    server = _Server.of_this_process()
    ours, theirs = _pipe()
    with theirs:
        pid = server.request(0, theirs)
    return Child(pid, ours, lambda: server.request(pid))


class _Server:
    """A process that forks workers, kept until this process ends."""

    _current: _Server | None = None
    _starting = threading.Lock()

    def __init__(self) -> None:
        self._owner, self._lock = os.getpid(), threading.Lock()
        self._connection, self._process = _start(*_PRELOAD)
        self._connection.send_bytes(pickle.dumps(_state()))
        atexit.register(self._end)

    @classmethod
    def of_this_process(cls) -> _Server:
        """Return the server; start one if there is none, or if it is that of a parent process."""
        with cls._starting:
            if cls._current is None or not cls._current._usable():
                cls._current = cls()
            return cls._current

    def _usable(self) -> bool:
        return self._owner == os.getpid() and self._process.poll() is None

    def request(self, number: int, connection: Connection | None = None) -> Any:
        """Let it fork a process for the end ``connection``, or wait for the process ``number``.

        Returns the identifier of the process, or its exit code, if that is known.
        """
        with self._lock:
            try:
                self._connection.send_bytes(pickle.dumps(number))
                if connection is not None:
                    reduction.send_handle(self._connection, connection.fileno(), None)
                answer = pickle.loads(self._connection.recv_bytes())  # noqa: S301 - our own
            except (EOFError, ConnectionError) as error:
                if number:
                    return None
                raise DiedError(f"their server {_ending(self._process.wait())}") from error
        if isinstance(answer, OSError):
            raise answer
        return answer

    def _end(self) -> None:
        if self._owner == os.getpid():
            self._process.kill()
            self._process.wait()


def _ending(code: int | None) -> str:
    """Return how a process ended, by its exit code."""
    if code is None:
        return "ended"
    if code >= 0:
        return f"ended with exit code {code}"
    name = signal.Signals(-code).name
    return f"was killed by {name}" + ("; is the memory full?" if -code == signal.SIGKILL else "")


def _start(*preload: str) -> tuple[Connection, subprocess.Popen[bytes]]:
    """Start a process that runs ``worker``; return the connection to it with it."""
    ours, theirs = _pipe()
    # -P: the working directory is not searched, not even for the imports of this first file.
    flags = [*subprocess._args_from_interpreter_flags(), "-P"]  # type: ignore[attr-defined]  # private
    command = [sys.executable, *flags, script.__file__, str(theirs.fileno()), *preload]
    # Ctrl-C, which reaches every process of a run in a terminal, must not interrupt its imports.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, script.STOPS)
    try:
        with theirs:
            return ours, subprocess.Popen(  # noqa: S603 - this interpreter and our own file
                command,
                stdin=subprocess.DEVNULL,
                stdout=_stream(1),
                stderr=_stream(2),
                pass_fds=[theirs.fileno()],
            )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _stream(descriptor: int) -> int | None:
    """Return a standard stream of a child: that of this process, or null if it is closed."""
    try:
        os.fstat(descriptor)
    except OSError:
        return subprocess.DEVNULL
    return None


def _pipe() -> tuple[Connection, Connection]:
    """Return both ends of a pipe, never those of a standard stream that is closed."""
    with contextlib.ExitStack() as stack:
        ends = [stack.enter_context(end) for end in Pipe()]
        ours, theirs = (fcntl.fcntl(end.fileno(), fcntl.F_DUPFD_CLOEXEC, 3) for end in ends)
    return Connection(ours), Connection(theirs)


def import_path() -> list[str]:
    """Return the folders in which this process looks for modules, in their order."""
    begun_in = Path(getattr(process, "ORIGINAL_DIR", None) or "")  # relative ones are seen from it
    return [str(begun_in / entry) for entry in sys.path]


def python_environment() -> dict[str, str]:
    """Return the environment of a Python program that imports from where this process does."""
    own = {"PYTHONSAFEPATH": "1", "PYTHONPATH": os.pathsep.join(import_path())}
    return {**os.environ, **own, plugins.VARIABLE: os.pathsep.join(plugins.configured_paths())}


def _state() -> dict[str, Any]:
    """Return what a child takes over from this process.

    ``modules``: files and folders of the top-level modules that this process has imported, without
    plugin files, which are loaded by their paths.
    """
    try:
        folder = str(Path.cwd())
    except OSError:  # it was removed
        folder = "/"
    places = {}
    for name, module in list(sys.modules.items()):
        spec = getattr(module, "__spec__", None)
        if "." in name or name.startswith(guard.USER_MODULE) or not isinstance(spec, ModuleSpec):
            continue
        if spec.name == name and spec.has_location and Path(str(spec.origin)).is_file():
            folders = spec.submodule_search_locations
            places[name] = str(spec.origin), None if folders is None else list(folders)
    return {
        "environment": dict(os.environ),
        "folder": folder,
        "argv": list(sys.argv),
        "path": import_path(),
        "modules": places,
    }
