"""Turn Ctrl-C and SIGTERM into a request to stop at the next safe point."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def interrupts(
    notice: str, on_request: Callable[[], None] = lambda: None
) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether Ctrl-C was pressed or SIGTERM was sent.

    The first signal prints the ``notice`` on stderr and calls ``on_request``; the work stops
    when it next calls the function. A second signal raises KeyboardInterrupt at once.
    """
    stopping = False

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal stopping
        if stopping:
            raise KeyboardInterrupt
        stopping = True
        print(f"\n{notice}", file=sys.stderr)
        on_request()

    signals = (signal.SIGINT, signal.SIGTERM)
    try:
        before = {number: signal.signal(number, ask) for number in signals}
    except ValueError:  # not in the main thread: the launcher handles signals
        before = {}
    try:
        yield lambda: stopping
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
