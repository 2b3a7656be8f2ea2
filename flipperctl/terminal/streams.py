"""Print any text on standard output and standard error; with ``--json``, one document alone.

Notices on a configuration, of plugins about their data and on sampled robots, are printed once.

A character that the encoding of a stream lacks (an old code page) is replaced by a question mark,
instead of an error.
"""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from flipperctl.config import EnvConfig


def replace_missing_characters() -> None:
    """Make stdout and stderr replace characters that their encoding lacks."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # it is None if there is no console
            stream.reconfigure(errors="replace")


_document: TextIO | None = None  # standard output, while it is reserved


@contextmanager
def reserved_stdout() -> Iterator[None]:
    """Reserve standard output for a document; all other prints, such as a plugin's, go to stderr.

    File descriptor 1 leads there as well, for worker processes and libraries in other languages.
    """
    global _document
    out = sys.stdout
    if out is None:  # there is no console
        yield
        return
    with ExitStack() as stack:
        _document = stack.enter_context(_moved(out))
        stack.enter_context(redirect_stdout(sys.stderr))
        try:
            yield
        finally:
            _document = None


@contextmanager
def _moved(out: TextIO) -> Iterator[TextIO]:
    """Yield a stream that writes where ``out`` did, and lead its file descriptor to stderr.

    The stream is ``out`` itself unless that is the process's own stdout; tests and notebooks have
    another one.
    """
    if out is not sys.__stdout__:
        yield out
        return
    # Streams of notebooks and tests have no descriptor.
    try:
        descriptor, error = out.fileno(), sys.stderr.fileno()
    except (AttributeError, OSError, ValueError):
        yield out
        return
    # The descriptor leads to stderr from here on; a copy still leads to where it did.
    out.flush()
    saved = os.dup(descriptor)
    os.dup2(error, descriptor)
    moved = os.fdopen(saved, "w", encoding=out.encoding, errors=out.errors)
    try:
        yield moved
    finally:
        os.dup2(saved, descriptor)
        with suppress(OSError):  # the first attempt to write has raised it
            moved.close()


def print_note(text: str) -> None:
    """Print a text on stderr, which leaves the results on stdout alone."""
    from flipperctl.text.show import print_text

    print_text(text, stderr=True)


_printed: set[str] = set()  # notices of this command


def begin_notices() -> None:
    """Forget the printed notices, at the start of a command."""
    _printed.clear()


def print_notices(config: EnvConfig) -> None:
    """Print the notices on a validated configuration that this command has not printed yet."""
    from flipperctl.config.defaults import notices

    for notice in notices(config):
        if notice not in _printed:
            _printed.add(notice)
            print_note(f"warning: {notice}")


def log_to_stderr() -> None:
    """Print the package's log messages to stderr, for debugging."""
    import logging

    log = logging.getLogger("flipperctl")
    log.setLevel(logging.DEBUG)
    log.handlers[:] = [logging.StreamHandler()]


def show(document: object, tables: Callable[[], None], *, as_json: bool) -> None:
    """Print ``document``, plain data, as JSON, or call ``tables`` to print the tables."""
    if as_json:
        print(json.dumps(document, indent=2), file=_document or sys.stdout, flush=True)
    else:
        tables()
        sys.stdout.flush()
