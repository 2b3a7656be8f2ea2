"""What every function of the interface has in common: plugins at its begin, short errors."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence

from flipperctl import entry
from flipperctl import plugins as registered
from flipperctl.errors import RequestError
from flipperctl.runs import follow_up
from flipperctl.terminal import notices

Paths = Sequence[str | os.PathLike[str]]


def begin(plugins: Paths) -> None:
    """Load the installed plugins and those at these paths, ``.py`` files or folders.

    Raises:
        PluginError: a plugin is missing, does not import or uses a taken name.
        RequestError: the paths are not a list.
    """
    if isinstance(plugins, str | os.PathLike):
        raise RequestError(f"plugins: a list of paths is allowed; the value is {plugins!r}")
    notices.begin()
    paths = [os.fspath(path) for path in plugins]
    follow_up.remember_plugins(paths)
    registered.load(paths)


@contextlib.contextmanager
def short_errors() -> Iterator[None]:
    """Leave the errors behind a refused request out of its traceback, since its text has them.

    With ``FLIPPERCTL_DEBUG=1`` they stay.
    """
    try:
        yield
    except RequestError as error:
        if os.environ.get(entry.DEBUG) != "1":
            error.__cause__ = None
        raise
