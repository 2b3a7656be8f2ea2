"""Turn Ctrl-C and signals of schedulers and terminals into a request to stop at a safe point."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from flipperctl import entry
from flipperctl.rollout.worker import STOPS

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
            raise KeyboardInterrupt
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
