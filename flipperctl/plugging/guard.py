"""Names the plugin, method, file and line of an error that a plugin's code raised.

In: an exception raised while the core called a plugin. Out: one of the package's own exceptions,
with one line of text. The methods of a plugin itself are guarded once, where the plugin is made
(``config.resolver``). Objects that a plugin returns, such as a world, are called within a context:

    with naming(engine, "advance"):
        poses = world.advance(samples, limits)

``SystemExit`` and ``GeneratorExit`` count as errors of the plugin too; only ``KeyboardInterrupt``
comes from the user.
"""

from __future__ import annotations

import inspect
import sysconfig
import traceback
from collections.abc import Callable
from numbers import Real
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, NoReturn

from pydantic import ValidationError

from flipperctl.api import Plugin
from flipperctl.errors import (
    FlipperctlError,
    MissingExtraError,
    PluginFailedError,
    missing_package,
)

_LONGEST = 300  # characters of an exception's text
_LIBRARIES = tuple({sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")})
_CORE = "flipperctl"
USER_MODULE = "flipperctl_user_"
"""Prefix of the packages of plugins that were loaded from a path, one for each folder."""
_NO_CALLERS = ("flipperctl.api", "flipperctl.testing")


class naming:  # noqa: N801  # used like a function, as contextlib's own contexts are
    """A context that re-raises every error as one that names a plugin and its method.

    A class, since a generator of ``contextlib`` takes six times as long to enter and exit.
    """

    __slots__ = ("_named", "_while")

    def __init__(
        self,
        plugin: Plugin | type[Plugin],
        method: str,
        raised: type[FlipperctlError] = PluginFailedError,
        *,
        while_: str = "",
    ) -> None:
        """Name ``plugin`` and ``method``; ``while_``: purpose of the call, for the text."""
        self._named, self._while = (plugin, method, raised), while_

    def __enter__(self) -> None:
        """Begin the context."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Re-raise ``error``, if there is one; see ``raise_named``."""
        if error is not None:
            raise_named(error, *self._named, while_=self._while)


def raise_named(
    error: BaseException,
    plugin: Plugin | type[Plugin],
    method: str,
    raised: type[FlipperctlError] = PluginFailedError,
    *,
    while_: str = "",
    plain: bool = False,
) -> NoReturn:
    """Raise an error that names the plugin whose ``method`` raised ``error``.

    If another plugin that this one called raised the error, the text names that other plugin.
    ``plain`` leaves out the exception's type, for methods that raise it to refuse a request. If no
    plugin is at fault, ``error`` itself is raised: an interrupt, or an error of the core that
    passed through the plugin.
    """
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    if isinstance(error, KeyboardInterrupt):
        raise error
    if isinstance(error, FlipperctlError) and frames and _is_core(frames[-1]):
        raise error
    plugin, method = _culprit(frames, plugin, method)
    where = error_place(error, plugin, method)
    what = _text(error) if plain else f"{method} raised {error_line(error)}"
    if missing := missing_package(error):
        what, raised = missing, MissingExtraError
    where = f"{method}, {where}" if plain else where
    raise raised(f"{plugin_label(plugin)}{while_}: {what} ({where})") from error


class Guarded:
    """An object that a plugin built; errors of its methods name plugin, method and place."""

    def __init__(self, plugin: Plugin, built: object) -> None:
        """Guard what ``plugin`` built."""
        self.plugin = plugin
        self.unguarded: Any = built
        """The plugin's own object."""

    def call(self, method: str, *given: Any) -> Any:
        """Return what a method of the object returns."""
        try:  # not ``naming``, since there are several calls in each decision
            return getattr(self.unguarded, method)(*given)
        except BaseException as error:  # noqa: BLE001  # raised again
            raise_named(error, self.plugin, method)

    def refusal(
        self,
        method: str,
        found: str,
        allowed: str,
        raised: type[FlipperctlError] = PluginFailedError,
    ) -> FlipperctlError:
        """Return the exception to raise for an invalid value that a method returned."""
        text, owner = f"returned {found}; allowed: {allowed}", type(self.unguarded)
        return refusal(self.plugin, method, text, raised, owner=owner)

    def save(self) -> Any:
        """Return a snapshot of the object's memory for ``load``."""
        return self.call("save")

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
        self.call("load", saved)


def is_called_by_core(error: BaseException) -> bool:
    """Return whether the core called the function that catches ``error``.

    The contract's base classes and the conformance suite do not count: their calls are treated as
    those of another plugin or of its author's test.
    """
    trace = error.__traceback__
    caller = trace.tb_frame.f_back if trace is not None else None
    if caller is None or not _is_core(caller):
        return False
    return not _module(caller).startswith(_NO_CALLERS)


def refusal(
    plugin: Plugin | type[Plugin],
    method: str,
    text: str,
    raised: type[FlipperctlError] = PluginFailedError,
    *,
    owner: type | None = None,
) -> FlipperctlError:
    """Return the exception to raise for an invalid value that a plugin's method returned.

    ``owner``: the class of the method, if it belongs to an object that the plugin built.
    """
    where = definition(owner or plugin, method)
    return raised(f"{plugin_label(plugin)}: {method} {text} ({where})")


def as_real(value: object, plugin: Plugin) -> Real | None:
    """Return the real number that ``__call__`` returned, alone or in an array; None: none."""
    with naming(plugin, "__call__"):
        if getattr(value, "shape", None) == ():
            value = value.item()  # type: ignore[attr-defined]  # arrays and tensors have item()
    return value if isinstance(value, Real) else None


def plugin_label(plugin: Plugin | type[Plugin]) -> str:
    """Return the name of a plugin for errors: its kind and its registered name."""
    cls = _class(plugin)
    return f"{cls.kind} {getattr(cls, 'plugin_name', cls.__name__)!r}"


def error_line(error: BaseException) -> str:
    """Return an exception as one line: its type and its text."""
    text = _text(error)
    return f"{_one_line(type(error).__name__, 60)}{': ' if text else ''}{text}"


def short_repr(value: object) -> str:
    """Return the ``repr`` of a value as one short line, even if ``repr`` fails."""
    return _one_line(_call_safely(repr, value), 60)


def error_place(error: BaseException, plugin: Plugin | type[Plugin], method: str) -> str:
    """Return file and line of the plugin's code that raised the error, else of the method."""
    steps = list(traceback.walk_tb(error.__traceback__))
    package = _package(_class(plugin).__module__)
    own = [s for s in steps if not _is_core(s[0]) and _package(_module(s[0])) == package]
    return _last(own or [s for s in steps if _is_foreign(s[0])]) or definition(plugin, method)


def import_place(error: BaseException, file: Path | None) -> str:
    """Return the file and line, in a plugin's ``file`` or else outside the core, of an error."""
    steps = list(traceback.walk_tb(error.__traceback__))
    own = [s for s in steps if file is not None and s[0].f_code.co_filename == str(file)]
    outside = [s for s in steps if not s[0].f_code.co_filename.startswith("<")]
    outside = [s for s in outside if not _is_core(s[0])]
    return _last(own or [s for s in outside if _is_foreign(s[0])] or outside)


def definition(plugin: Plugin | type, method: str = "") -> str:
    """Return file and line of a method's definition, else of its plugin's, else the module."""
    cls: type = plugin if isinstance(plugin, type) else type(plugin)
    found = inspect.getattr_static(cls, method, None) if method else None
    function = getattr(found, "fget", found)
    code = getattr(inspect.unwrap(function) if function else None, "__code__", None)
    if code is not None:
        return f"{_one_line(code.co_filename, 400)}:{code.co_firstlineno}"
    try:
        return f"{inspect.getsourcefile(cls)}:{inspect.getsourcelines(cls)[1]}"
    except (OSError, TypeError):
        return cls.__module__


def _culprit(
    frames: list[FrameType], plugin: Plugin | type[Plugin], method: str
) -> tuple[Plugin | type[Plugin], str]:
    """Return the innermost plugin that was running, and its method that was called."""
    seen: object = None
    for frame in frames:
        for name in ("self", "cls"):
            owner: Any = frame.f_locals.get(name)
            cls = owner if isinstance(owner, type) else type(owner)
            if not issubclass(cls, Plugin) or owner is seen or _is_core(frame):
                continue
            # The plugin's own code rather than that of a library
            if _is_foreign(frame) or _package(_module(frame)) == _package(cls.__module__):
                seen, plugin, method = owner, owner, frame.f_code.co_name
    return plugin, method


def _text(error: BaseException) -> str:
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        setting = ".".join([error.title, *map(str, first["loc"])])
        return _one_line(f"{setting}: {first['msg'].removeprefix('Value error, ')}", _LONGEST)
    text = _call_safely(str, error).partition("For further information visit")[0].rstrip()
    return _one_line(text, _LONGEST)


def _class(plugin: Plugin | type[Plugin]) -> type[Plugin]:
    return plugin if isinstance(plugin, type) else type(plugin)


def _last(steps: list[tuple[FrameType, int]]) -> str:
    return f"{_one_line(steps[-1][0].f_code.co_filename, 400)}:{steps[-1][1]}" if steps else ""


def _package(module: str) -> str:
    return module.partition(".")[0]


def _module(frame: FrameType) -> str:
    return str(frame.f_globals.get("__name__", ""))


def _is_core(frame: FrameType) -> bool:
    return _package(_module(frame)) == _CORE


def _is_foreign(frame: FrameType) -> bool:
    """Return whether the code belongs neither to flipperctl's core nor to a library."""
    file = frame.f_code.co_filename
    return not (_is_core(frame) or file.startswith(("<", *_LIBRARIES)))


def _call_safely(how: Callable[[Any], str], value: object) -> str:
    try:
        return how(value)
    except KeyboardInterrupt:
        raise
    except BaseException:  # noqa: BLE001  # a plugin's own __str__ may raise anything
        return f"<{type(value).__name__}>"


def _one_line(text: str, longest: int) -> str:
    line = " ".join(text[: 20 * longest].split())
    line = "".join(c if c.isprintable() else "?" for c in line)
    if len(line) <= longest:
        return line
    half = (longest - 3) // 2  # the cause is often at the end, after a long path
    return f"{line[:half]}...{line[-half:]}"
