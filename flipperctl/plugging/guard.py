"""Names the plugin, method, file and line of an error that a plugin's code raised.

In: an exception. Out: one of the package's own exceptions, with one line of text. Calls of a plugin
are not guarded: its error is raised as it is, and ``naming_plugins`` finds the plugin in the
traceback once, where a program, a worker or an evaluation ends. ``naming`` is for calls that refuse
a plugin before it is used, with an exit code of their own.

``SystemExit`` and ``GeneratorExit`` count as errors of the plugin too; only ``KeyboardInterrupt``
comes from the user.
"""

from __future__ import annotations

import inspect
import sysconfig
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from numbers import Real
from types import FrameType
from typing import Any, NoReturn

from pydantic import ValidationError

from flipperctl.api import Plugin, registry
from flipperctl.errors import (
    FlipperctlError,
    MissingExtraError,
    PluginFailedError,
    missing_package,
)

_LONGEST = 300  # characters of an exception's text
_LIBRARIES = tuple({sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")})
_CORE = "flipperctl"
OWN = (_CORE, "flipperctl_plugins")
"""Packages whose plugins the version of flipperctl describes."""
USER_MODULE = "flipperctl_user_"
"""Prefix of the packages of plugins that were loaded from a path, one for each folder."""


@contextmanager
def naming(
    plugin: Plugin | type[Plugin],
    method: str,
    raised: type[FlipperctlError] = PluginFailedError,
    *,
    while_: str = "",
) -> Iterator[None]:
    """Re-raise every error as one that names a plugin and its method.

    ``while_``: purpose of the call, for the text.
    """
    try:
        yield
    except BaseException as error:  # noqa: BLE001  # raised again
        raise_named(error, plugin, method, raised, while_=while_)


@contextmanager
def refusing(plugin: Plugin, method: str, raised: type[FlipperctlError]) -> Iterator[None]:
    """Raise ``raised`` for a ``ValueError``, by which a method refuses settings or a request."""
    try:
        yield
    except ValueError as error:
        raise_named(error, plugin, method, raised, plain=True)


@contextmanager
def naming_plugins() -> Iterator[None]:
    """Re-raise an error of any plugin's code as a ``PluginFailedError`` that names its place."""
    try:
        yield
    except BaseException as error:
        if named := attributed(error):
            raise named from error
        raise


def attributed(error: BaseException) -> FlipperctlError | None:
    """Return an error that names the plugin whose code raised ``error``; None if none did.

    The place is the innermost frame outside the package and its libraries. What called the package,
    such as a script, is no plugin.
    """
    if not (called := _innermost_call(error)):
        return None
    plugin, method = _culprit(called)
    # An object that a plugin built has a class in the plugin's module.
    modules = {_module(frame) for frame, _ in called}
    classes = [cls for cls in registry.values() if cls.__module__ in modules]
    labels = " or ".join(plugin_label(cls) for cls in ([plugin] if plugin else classes))
    return _named(error, f"{labels}: ", method, _last(called)) if labels else None


def is_built_in(plugin: Plugin | type[Plugin]) -> bool:
    """Return whether a plugin is part of flipperctl."""
    module = (plugin if isinstance(plugin, type) else type(plugin)).__module__
    return module.partition(".")[0] in OWN


def raise_named(
    error: BaseException,
    plugin: Plugin | type[Plugin],
    method: str,
    raised: type[FlipperctlError] = PluginFailedError,
    *,
    while_: str = "",
    plain: bool = False,
) -> NoReturn:
    """Raise an error that names the plugin whose ``method`` raised ``error``, or one inside it.

    ``plain`` leaves out the exception's type, for methods that raise it to refuse a request. An
    interrupt, or an error of the core that passed through the plugin, is raised as it is.
    """
    if called := _innermost_call(error):
        culprit, entered = _culprit(called)
        plugin, method = (culprit, entered) if culprit else (plugin, method)
    elif isinstance(error, KeyboardInterrupt | FlipperctlError):
        raise error
    where = place(error) or definition(plugin, method)
    if plain:
        # A built-in plugin's reason is enough; a user's own may be a mistake in its code.
        at = "" if is_built_in(plugin) else f" ({method}, {where})"
        raise raised(f"{plugin_label(plugin)}: {_text(error)}{at}") from error
    raise _named(error, f"{plugin_label(plugin)}{while_}: ", method, where, raised) from error


def _named(
    error: BaseException,
    label: str,
    method: str,
    where: str,
    raised: type[FlipperctlError] = PluginFailedError,
) -> FlipperctlError:
    """Return the exception that says what was raised where; a missing package has its own."""
    notes = ""
    if not isinstance(error, FlipperctlError):  # whose text has its notes
        notes = "".join(f"; {note}" for note in getattr(error, "__notes__", ()))
    if missing := missing_package(error):
        return MissingExtraError(f"{label}{missing} ({where}){notes}")
    return raised(f"{label}{method} raised {error_line(error)} ({where}){notes}")


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


def as_real(value: Any) -> Real | None:
    """Return a real number, alone or in an array or tensor; None: none."""
    if getattr(value, "shape", None) == ():
        value = value.item()
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
    """Return the ``repr`` of a value as one short line."""
    return _one_line(repr(value), 60)


def place(error: BaseException, package: str = "") -> str:
    """Return file and line of the innermost frame outside the core and its libraries, or "".

    ``package``: one of a plugin that is not registered yet.
    """
    return _last(_outside(traceback.walk_tb(error.__traceback__), package))


def definition(plugin: Plugin | type, method: str = "") -> str:
    """Return file and line of a method's definition, else of its plugin's, else the module."""
    cls: type = plugin if isinstance(plugin, type) else type(plugin)
    attribute = inspect.getattr_static(cls, method, None) if method else None
    function = getattr(attribute, "fget", attribute)
    code = getattr(inspect.unwrap(function) if function else None, "__code__", None)
    if code is not None:
        return f"{_one_line(code.co_filename, 400)}:{code.co_firstlineno}"
    try:
        return f"{inspect.getsourcefile(cls)}:{inspect.getsourcelines(cls)[1]}"
    except (OSError, TypeError):
        return cls.__module__


_Steps = list[tuple[FrameType, int]]
"""Frames of a traceback with their lines, the outermost first."""


def _outside(steps: Iterable[tuple[FrameType, int]], package: str = "") -> _Steps:
    """Return the steps outside the core and its libraries, installed plugins included."""
    packages = {package, *(_package(cls.__module__) for cls in registry.values())} - {_CORE}
    return [s for s in steps if _is_foreign(s[0]) or _package(_module(s[0])) in packages]


def _innermost_call(error: BaseException) -> _Steps:
    """Return the core's innermost call of a plugin: its own frame, then the plugin's frames.

    Empty of an interrupt, or of an error of the core's own, as of a wrong argument.
    """
    steps = list(traceback.walk_tb(error.__traceback__))
    is_core_error = isinstance(error, FlipperctlError) and bool(steps) and _is_core(steps[-1][0])
    if is_core_error or isinstance(error, KeyboardInterrupt):
        return []
    # From the inside: the first frame of the core that leads out of it
    for at in reversed(range(len(steps))):
        frame = steps[at][0]
        if _is_core(frame) and _module(frame) != __name__ and (called := _outside(steps[at:])):
            return [steps[at], *called]
    return []


def _culprit(called: _Steps) -> tuple[Plugin | type[Plugin] | None, str]:
    """Return the plugin that ran innermost, if a frame has it, and its method there."""
    for frame, _ in reversed(called):
        for name in ("self", "cls"):
            owner: Any = frame.f_locals.get(name)
            cls = owner if isinstance(owner, type) else type(owner)
            if issubclass(cls, Plugin) and _package(cls.__module__) != _CORE:
                return owner, frame.f_code.co_name
    return None, called[1][0].f_code.co_name


def _text(error: BaseException) -> str:
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        setting = ".".join([error.title, *map(str, first["loc"])])
        return _one_line(f"{setting}: {first['msg'].removeprefix('Value error, ')}", _LONGEST)
    text = str(error).partition("For further information visit")[0].rstrip()
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


def _one_line(text: str, longest: int) -> str:
    line = " ".join(text[: 20 * longest].split())
    line = "".join(c if c.isprintable() else "?" for c in line)
    if len(line) <= longest:
        return line
    half = (longest - 3) // 2  # the cause is often at the end, after a long path
    return f"{line[:half]}...{line[-half:]}"
