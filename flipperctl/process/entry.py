"""Start and exit of every program of the package: one line for an error, exit codes.

A program calls ``run``, inside which it imports what is slow, so that Ctrl-C during an import is
one line as well.
"""

from __future__ import annotations

import contextlib
import errno
import gc
import os
import re
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import NoReturn, TextIO

from flipperctl.errors import (
    FlipperctlError,
    InterruptedRunError,
    MissingExtraError,
    RequestError,
    missing_package,
)

STOPS = (
    signal.SIGINT,
    signal.SIGTERM,
    signal.SIGHUP,
    signal.SIGUSR1,
    signal.SIGUSR2,
    signal.SIGXCPU,
)
"""Signals by which people and schedulers stop a run, often all its processes at once."""
_MEMORY = re.compile("can't allocate memory|out of memory")
"""How torch says that a processor or a graphics card has no more, in a RuntimeError."""
DEBUG = "FLIPPERCTL_DEBUG"
"""Environment variable; with 1, errors are shown with their traceback."""


def run(program: Callable[[], int]) -> NoReturn:
    """Run a program and exit with the code that it returns.

    An error prints one line on stderr and has its own exit code. Ctrl-C exits with 130, a pipe
    closed by its reader (``| head``) with 1.
    """
    # Searching the objects of imports, which last, for garbage took half a second with torch.
    gc.set_threshold(70_000)
    code = _code_of(program)
    # The interpreter's own flush at exit would print its error in its own way; this comes first.
    for stream in filter(None, (sys.stdout, sys.stderr)):
        try:
            stream.flush()
        except OSError as error:
            if code == 0 and error.errno != errno.EPIPE:
                print_error(f"standard output cannot be written: {error.strerror}")
            code = code or FlipperctlError.exit_code
            discard(stream)
    sys.exit(code)


def print_error(text: str) -> None:
    """Print ``error:`` and the text on stderr, if stderr can be written."""
    with contextlib.suppress(OSError):
        print(f"error: {text}", file=sys.stderr)


def _code_of(program: Callable[[], int]) -> int:
    """Return the program's exit code; print the error that ended it."""
    global _interrupted  # as below
    _interrupted = False
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt)
    try:
        return program()
    except SystemExit:
        raise  # Hydra's options exit this way; a plugin's exit is already a PluginError
    except BrokenPipeError:
        return FlipperctlError.exit_code  # the reader closed the pipe
    except BaseException as error:
        # A library may have made an error of its own of Ctrl-C, as while it was imported.
        failed = isinstance(error, FlipperctlError) and not isinstance(error, RequestError)
        if isinstance(error, KeyboardInterrupt) or (_interrupted and not failed):
            print_error("interrupted")
            return InterruptedRunError.exit_code
        if os.environ.get(DEBUG) == "1":
            raise
        text, code = _described(error)
        print_error(text)
        return code


_interrupted = False
"""Whether Ctrl-C has interrupted this process."""


def interrupt(number: int, frame: FrameType | None) -> NoReturn:
    """Raise KeyboardInterrupt, of which a library may make an error of its own."""
    global _interrupted  # signals are the process's
    _interrupted = True
    raise KeyboardInterrupt


def _described(error: BaseException) -> tuple[str, int]:
    """Return the line for an error, and its exit code."""
    if isinstance(error, FlipperctlError):
        return str(error), error.exit_code
    if missing := missing_package(error):
        return missing, MissingExtraError.exit_code
    if isinstance(error, MemoryError) or _MEMORY.search(str(error)):
        return f"there is not enough memory: {error}", FlipperctlError.exit_code
    if isinstance(error, OSError) and error.errno:  # what the system refuses is no fault of ours
        place = error.filename or "the system refuses"
        named = error.errno in (errno.ENAMETOOLONG, errno.ELOOP)  # a name that the user gave
        code = RequestError.exit_code if named else FlipperctlError.exit_code
        return f"{place}: {os.strerror(error.errno)}", code
    return (
        f"{type(error).__name__}: {error} (an error in flipperctl; {DEBUG}=1 shows where)",
        FlipperctlError.exit_code,
    )


def discard(stream: TextIO) -> None:
    """Redirect the stream to null, so that the interpreter's last flush prints no error."""
    with contextlib.suppress(OSError, ValueError):  # a test's stream has no descriptor
        sink = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(sink, stream.fileno())
        finally:
            os.close(sink)
