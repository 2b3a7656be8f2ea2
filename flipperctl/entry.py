"""Start and exit of every program of the package: Ctrl-C, closed pipes, full disks, exit codes.

A program calls ``stop_at_once`` before its other imports, then ``run``, which exits with an exit
code. This module imports nothing slow, since it is loaded first.
"""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import sys

from flipperctl.errors import (
    FlipperctlError,
    InterruptedRunError,
    MissingExtraError,
    RequestError,
    missing_package,
)

TYPE_CHECKING = False  # importing typing takes 5 ms, during which Ctrl-C shows a traceback
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType
    from typing import NoReturn, TextIO

DEBUG = "FLIPPERCTL_DEBUG"
"""Environment variable; with 1, errors are shown with their traceback."""
STDOUT = "standard output"
_BROKEN = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF}
_SHORTAGES = _BROKEN | {errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN, errno.EROFS}
"""Errors that the machine causes, not a program."""
_IMPORT = "<frozen importlib._bootstrap"
_process_id = 0  # of this process, set by stop_at_once


def stop_at_once() -> None:
    """Make Ctrl-C end the process without a traceback, and closed standard streams lead nowhere.

    A handler that was set before, such as that of ``nohup``, stays.
    """
    global _process_id
    _open_closed_streams()
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        _process_id = os.getpid()
        signal.signal(signal.SIGINT, _stop)


def _open_closed_streams() -> None:
    """Connect standard streams that are closed (``>&-``) to null.

    Otherwise the next file that is opened would be taken for one of them.
    """
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(descriptor, True)  # as a child's standard stream, too
    os.close(descriptor)
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            null = open(os.devnull, "r" if name == "stdin" else "w")  # noqa: PTH123, SIM115
            setattr(sys, name, null)


def run(program: Callable[[], int]) -> NoReturn:
    """Run a program and exit with the code that it returns.

    An error prints one line on stderr and has its own exit code. Ctrl-C exits with 130, a pipe
    closed by its reader (``| head``) with 1.
    """
    own_handler = signal.getsignal(signal.SIGINT) is _stop
    if own_handler:
        signal.signal(signal.SIGINT, _interrupt)
    try:
        try:
            code = _code_of(program)
        finally:
            if own_handler:
                signal.signal(signal.SIGINT, _stop)
    except KeyboardInterrupt:
        print_error("interrupted")
        code = InterruptedRunError.exit_code
    error = _flush()
    if error is not None and code == 0:
        code = FlipperctlError.exit_code
        if error.errno in _BROKEN:
            code = _report_output_failure(os.strerror(error.errno))
    sys.exit(code)


def print_error(text: str) -> None:
    """Print ``error:`` and the text on stderr, if stderr can be written."""
    with contextlib.suppress(OSError):
        print(f"error: {text}", file=sys.stderr)


def _code_of(program: Callable[[], int]) -> int:
    debug = os.environ.get(DEBUG) == "1"
    try:
        return program()
    except FlipperctlError as error:
        if isinstance(error, RequestError) and _after_interrupt(error):
            raise KeyboardInterrupt from error
        if debug:
            raise
        print_error(str(error))
        return error.exit_code
    except BrokenPipeError:
        return FlipperctlError.exit_code  # the reader closed the pipe
    except (KeyboardInterrupt, SystemExit):
        raise  # Hydra's options exit this way; a plugin's exit is already a PluginError
    except BaseException as error:
        if isinstance(error, OSError):  # files are written by flipperctl.files, with its own errors
            broken = error.filename is None and error.errno in _BROKEN and is_broken(sys.stdout)
            if broken or error.filename == STDOUT:
                return _report_output_failure(os.strerror(error.errno or 0))
        if _after_interrupt(error):
            raise KeyboardInterrupt from error
        if debug:
            raise
        if isinstance(error, OSError) and error.errno in _SHORTAGES:
            print_error(_describe_shortage(error))
            return FlipperctlError.exit_code
        if missing := missing_package(error):
            print_error(missing)
            return MissingExtraError.exit_code
        print_error(
            f"{type(error).__name__}: {error} (an error in flipperctl; {DEBUG}=1 shows where)"
        )
        return FlipperctlError.exit_code


def _after_interrupt(error: BaseException | None) -> bool:
    """Return whether Ctrl-C caused the error, which a library may have replaced."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _stop(number: int, frame: FrameType | None) -> None:
    with contextlib.suppress(OSError):
        os.write(2, b"error: interrupted\n")  # print may be running already
    os._exit(InterruptedRunError.exit_code)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, or end the process if a module is being imported.

    Libraries report an exception during their import as their own failure.
    """
    inner = frame if os.getpid() == _process_id else None
    while inner is not None:
        if inner.f_code.co_filename.startswith(_IMPORT):
            _stop(number, frame)
        inner = inner.f_back
    raise KeyboardInterrupt


def is_broken(stream: TextIO) -> bool:
    """Return whether a stream cannot be written, after an error that may have been of another one.

    The end of a line is tried, since a stream may have dropped what it could not write.
    """
    try:
        print(file=stream, flush=True)
    except (OSError, ValueError):
        return True
    return False


def _describe_shortage(error: OSError) -> str:
    """Return what the system has refused, with the place where it is known, and what needs less."""
    reason = os.strerror(error.errno or 0)
    if error.filename is not None:
        return f"{error.filename}: {reason}"
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return f"{reason}: raise their limit (ulimit -n), or use fewer processes (--jobs 1)"
    return (
        f"{reason}: the system refuses memory, a process, or the semaphores in /dev/shm that "
        "hydra/launcher=joblib needs; --jobs 1 and train.mode=exact need none"
    )


def _report_output_failure(reason: str) -> int:
    print_error(f"{STDOUT} cannot be written: {reason}")
    return FlipperctlError.exit_code


def _flush() -> OSError | None:
    """Flush standard output and standard error; return the first error, if any."""
    first: OSError | None = None
    for stream in (sys.stdout, sys.stderr):
        if stream is None or stream.closed:
            continue
        try:
            stream.flush()
        except OSError as error:
            first = first or error
            discard(stream)
    return first


def discard(stream: TextIO) -> None:
    """Redirect the stream to null, so that the interpreter's last flush prints no error."""
    with contextlib.suppress(OSError, ValueError):  # a test's stream has no descriptor
        sink = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(sink, stream.fileno())
        finally:
            os.close(sink)
