"""A worker process: it runs the calls that come through a connection, or forks processes that do.

In: pickled calls ``(function, arguments)``. Out: pickled ``(ok, value or error, traceback)``. The
process runs this file as a script, which imports the standard library alone until it knows where
its parent imports from. Python itself would let a child import from its working directory.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import select
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from multiprocessing import reduction
from multiprocessing.connection import Connection
from typing import Any, ClassVar, NoReturn

STOPS = (
    signal.SIGINT,
    signal.SIGTERM,
    signal.SIGHUP,
    signal.SIGUSR1,
    signal.SIGUSR2,
    signal.SIGXCPU,
)
"""Signals by which people, terminals and schedulers stop a run, often all its processes at once."""
_GRACE = 1.0
"""Time that a worker has to end by itself after its parent [s]."""


def main(descriptor: int, preload: list[str]) -> None:
    """Work for the process at the other end; with ``preload``, fork workers instead."""
    for number in STOPS:  # the main process handles them and stops its workers
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)
    sys.meta_path.insert(0, _ParentModules)
    connection = Connection(descriptor)
    _run(_serve if preload else _work, connection, *preload)


def _run(work: Callable[..., None], connection: Connection, *preload: str) -> NoReturn:
    """Work until the parent closes the connection; then end without the interpreter's farewell."""
    try:
        with contextlib.suppress(EOFError, OSError):
            work(connection, *preload)
    except BaseException:  # noqa: BLE001 - a fork must never return into the server's code
        traceback.print_exc()
        os._exit(1)
    finally:
        os._exit(0)


class _ParentModules:
    """Finds the top-level modules that the parent has imported where the parent found them."""

    places: ClassVar[dict[str, tuple[str, list[str] | None]]] = {}
    """File and, for a package, its folders, by the names of the modules."""

    @classmethod
    def find_spec(cls, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Return the specification of a module, or None for one that the parent lacks."""
        if name not in cls.places:
            return None
        file, folders = cls.places[name]
        return spec_from_file_location(name, file, submodule_search_locations=folders)


def _enter(state: dict[str, Any]) -> None:
    """Take over the state of the parent, which may have changed since a server began."""
    os.environ.clear()
    os.environ.update(state["environment"])
    with contextlib.suppress(OSError):  # it was removed
        os.chdir(state["folder"])
    sys.argv[:], sys.path[:] = state["argv"], state["path"]
    _ParentModules.places = state["modules"]


def _serve(connection: Connection, *preload: str) -> None:
    """Fork a worker for each request 0; for any other, wait for this process; answer a number.

    Each worker has what ``preload`` imports. The answer is the process identifier or the exit code,
    or the error of the system.
    """
    _enter(pickle.loads(connection.recv_bytes()))  # noqa: S301 - from the parent
    for name in preload:
        with contextlib.suppress(Exception):  # a worker that needs it raises it
            importlib.import_module(name)
    while True:
        number = pickle.loads(connection.recv_bytes())  # noqa: S301 - from the parent
        answer: int | OSError
        try:
            answer = _wait(number) if number else _fork(connection)
        except OSError as error:
            answer = error
        connection.send_bytes(pickle.dumps(answer))


def _wait(pid: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def _fork(connection: Connection) -> int:
    descriptor = reduction.recv_handle(connection)
    try:
        if pid := os.fork():
            return pid
        connection.close()
        _run(_work, Connection(descriptor))
    finally:
        os.close(descriptor)


def _work(connection: Connection) -> None:
    """Answer calls until the parent closes the connection."""
    threading.Thread(target=_exit_with_parent, args=(connection.fileno(),), daemon=True).start()
    _enter(pickle.loads(connection.recv_bytes()))  # noqa: S301 - from the parent
    while True:
        connection.send_bytes(_answer(connection.recv_bytes()))


def _answer(call: bytes) -> bytes:
    """Run a call; return its pickled answer."""
    try:
        function, arguments = pickle.loads(call)  # noqa: S301 - from the parent
        return pickle.dumps((True, function(*arguments), ""))
    except BaseException as error:  # noqa: BLE001 - raised in the parent
        text = traceback.format_exc()
        try:
            answer = pickle.dumps((False, error, text))
            pickle.loads(answer)  # noqa: S301 - an exception's own constructor may refuse
        except Exception:  # noqa: BLE001 - of the exception's class
            answer = pickle.dumps((False, RuntimeError(f"{type(error).__name__}: {error}"), text))
        return answer
    finally:
        for stream in (sys.stdout, sys.stderr):  # the parent may end this process at any time
            with contextlib.suppress(Exception):
                stream.flush()


def _exit_with_parent(descriptor: int) -> None:
    """Wait for the end of the parent process, then end this one, even within a call."""
    poll = select.poll()
    poll.register(descriptor, 0)  # that the other end is closed is reported unasked
    poll.poll()
    time.sleep(_GRACE)
    os._exit(1)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
