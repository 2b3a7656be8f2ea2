"""This command as a process: Ctrl-C, its plugins, and the commands by which a user goes on.

In: words of a command, the paths of ``--plugins``, signals. Out: lines for the shell (installed
plugins and those of ``FLIPPERCTL_PLUGINS`` need no option), and a request to stop at a safe point.
"""

from __future__ import annotations

import shlex
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from flipperctl.errors import InterruptedRunError
from flipperctl.process import entry
from flipperctl.process.entry import STOPS

_plugin_paths: list[str] = []


def remember_plugins(paths: Iterable[str | Path] | None) -> None:
    """Remember the paths of ``--plugins`` as they were typed, in place of earlier ones."""
    _plugin_paths[:] = map(str, paths or ())


def plugin_paths() -> list[str]:
    """Return the remembered paths, for a worker process that prints commands too."""
    return list(_plugin_paths)


def command(*words: str | Path) -> str:
    """Return ``flipperctl`` with these words and the remembered plugins, quoted for the shell.

    A path inside the working directory is printed relative to it.
    """
    typed = [_short(word) if isinstance(word, Path) else word for word in words]
    plugins = [part for path in _plugin_paths for part in ("--plugins", path)]
    return shlex.join(["flipperctl", *typed, *plugins])


def interrupted_run(run: Path) -> InterruptedRunError:
    """Return the error for a training that Ctrl-C stopped, with the command that resumes it."""
    return InterruptedRunError(f"interrupted. Resume with: {command('train', '--resume', run)}")


def quote_path(path: Path) -> str:
    """Return a path relative to the working directory, if it is inside, quoted for the shell."""
    return shlex.quote(_short(path))


def _short(path: Path) -> str:
    here = Path.cwd()
    text = str(path.relative_to(here) if path.is_relative_to(here) else path)
    return f"./{text}" if text.startswith(("-", "~")) else text  # else an option, or a home folder


_URGENT = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def interrupts(
    notice: str, on_request: Callable[[], None] = lambda: None
) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether Ctrl-C was pressed or a signal of ``STOPS`` was sent.

    The first signal prints the ``notice`` on stderr and calls ``on_request``; the work stops
    when it next calls the function. A second SIGINT or SIGTERM raises KeyboardInterrupt at once;
    the others are sent repeatedly. A signal other than these two that is ignored, as SIGHUP behind
    ``nohup``, or that the caller handles, stays so.
    """
    stopping = urgent = False

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal stopping, urgent
        if urgent and number in _URGENT:
            entry.interrupt(number, frame)
        urgent = urgent or number in _URGENT
        if stopping:
            return
        stopping = True
        try:
            print(f"\n{notice}", file=sys.stderr, flush=True)
        except OSError:  # the terminal has gone; what is printed there later shall not fail
            for stream in (sys.stdout, sys.stderr):
                entry.discard(stream)
        on_request()

    # Of the signals that the caller handles, only SIGINT and SIGTERM are taken from it.
    before = {}
    try:
        for number in STOPS:
            if number in _URGENT or signal.getsignal(number) is signal.SIG_DFL:
                before[number] = signal.signal(number, ask)
    except ValueError:  # not in the main thread: the launcher handles signals
        pass
    try:
        yield lambda: stopping
    finally:
        for number, handler in before.items():
            if handler is not None:  # one of a library in another language is lost
                signal.signal(number, handler)
