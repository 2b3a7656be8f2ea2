"""Close everything that a training opened, even after errors.

In: objects with a ``close``. Out: the first error, after all of them were closed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol, TypeVar


class Closable(Protocol):
    """Holds a resource."""

    def close(self) -> None:
        """Release the resource."""


ClosableT = TypeVar("ClosableT", bound=Closable)


@contextmanager
def closing(opened: Sequence[Closable]) -> Iterator[None]:
    """Close everything in ``opened`` when the block ends, newest first.

    The block may add to ``opened``. Its own error is raised, otherwise the first of closing.
    """
    errors: list[BaseException] = []
    try:
        yield
    except BaseException as error:  # noqa: BLE001  # raised below
        errors.append(error)
    for one in reversed(opened):
        try:
            one.close()
        except BaseException as error:  # noqa: BLE001  # raised below; the others are closed first
            errors.append(error)
    if errors:
        raise errors[0]


def open_all(makers: Iterable[Callable[[], ClosableT]]) -> list[ClosableT]:
    """Return the objects of the makers; if a maker fails, close those made before."""
    opened: list[ClosableT] = []
    try:
        for make in makers:
            opened.append(make())  # noqa: PERF401  # the list is closed if a later one fails
    except BaseException:
        with closing(opened):
            raise
    return opened
