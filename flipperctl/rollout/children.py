"""Child processes that import what this process has imported, from wherever it did.

In: nothing. Out: processes that answer calls (``worker``). Nothing of this process is changed,
neither its environment and signal mask nor ``multiprocessing``, which the caller may use itself.
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
from collections.abc import Callable, Iterator
from importlib.machinery import ModuleSpec
from multiprocessing import Pipe, process, reduction
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from flipperctl import plugins
from flipperctl.guard import USER_MODULE
from flipperctl.rollout import worker

_PRELOAD = ("flipperctl.rollout.actor", "flipperctl.sim.planar.compiled")
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
    connection, process = _start()
    return Child(process.pid, connection, process.wait)


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

        Returns the identifier of the process, or its exit code, None if that is not known.
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
    command = [sys.executable, *flags, worker.__file__, str(theirs.fileno()), *preload]
    with theirs, _blocked_stops():
        started = subprocess.Popen(  # noqa: S603 - this interpreter and our own file
            command,
            stdin=subprocess.DEVNULL,
            stdout=_stream(1),
            stderr=_stream(2),
            pass_fds=[theirs.fileno()],
        )
    return ours, started


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
    """Return what a child takes over from this process."""
    try:
        folder = str(Path.cwd())
    except OSError:  # it was removed
        folder = "/"
    return {
        "environment": dict(os.environ),
        "folder": folder,
        "argv": list(sys.argv),
        "path": import_path(),
        "modules": _places(),
    }


def _places() -> dict[str, tuple[str, list[str] | None]]:
    """Return the files and folders of the top-level modules that this process has imported.

    Plugin files, which are loaded by their paths, are not among them.
    """
    found = {}
    for name, module in list(sys.modules.items()):
        spec = getattr(module, "__spec__", None)
        if "." in name or name.startswith(USER_MODULE) or not isinstance(spec, ModuleSpec):
            continue
        if spec.name == name and spec.has_location and Path(str(spec.origin)).is_file():
            folders = spec.submodule_search_locations
            found[name] = str(spec.origin), None if folders is None else list(folders)
    return found


@contextlib.contextmanager
def _blocked_stops() -> Iterator[None]:
    """Block the signals that stop a run in this thread, while a process starts and inherits it.

    Ctrl-C, which reaches every process of the run in a terminal, must not interrupt its imports.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, worker.STOPS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
