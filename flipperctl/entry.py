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
_BROKEN = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF}
_IMPORT = "<frozen importlib._bootstrap"
_process_id = 0  # of this process, set by stop_at_once


def stop_at_once() -> None:
    """Make Ctrl-C end the process without a traceback.

    A handler that was set before, such as that of ``nohup``, stays.
    """
    global _process_id
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        _process_id = os.getpid()
        signal.signal(signal.SIGINT, _stop)


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
        if reason := _failure_reason(error):
            code = _report_output_failure(reason)
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
        if isinstance(error, Exception) and (reason := _failure_reason(error)):
            return _report_output_failure(reason)
        if _after_interrupt(error):
            raise KeyboardInterrupt from error
        if debug:
            raise
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
    if os.getpid() == _process_id and _importing(frame):
        _stop(number, frame)
    raise KeyboardInterrupt


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith(_IMPORT):
            return True
        frame = frame.f_back
    return False


def _failure_reason(error: Exception) -> str:
    """Return why standard output could not be written, or an empty text for any other error.

    Files are written by ``flipperctl.files``, which raises flipperctl's own errors.
    """
    if isinstance(error, OSError) and error.filename is None and error.errno in _BROKEN:
        return os.strerror(error.errno)
    return ""


def _report_output_failure(reason: str) -> int:
    print_error(f"standard output cannot be written: {reason}")
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
            _discard(stream)
    return first


def _discard(stream: TextIO) -> None:
    """Redirect the stream to null, so that the interpreter's last flush prints no error."""
    with contextlib.suppress(OSError, ValueError):  # a test's stream has no descriptor
        sink = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(sink, stream.fileno())
        finally:
            os.close(sink)
