"""Guard the methods of plugins once, where the core creates the plugins.

In: the class of a plugin that the core has created. Out: the same class, whose methods name plugin,
method, file and line when they fail. Only errors in calls by the core are replaced: another plugin
or the author's own test gets the original error and may catch it.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator
from typing import Any
from weakref import WeakSet

from flipperctl.api import Plugin
from flipperctl.errors import (
    ConfigError,
    FlipperctlError,
    PluginError,
    PluginFailedError,
    TerrainError,
)
from flipperctl.guard import is_called_by_core, raise_named

_CONTRACT = "flipperctl.api"
_guarded: WeakSet[Callable[..., object]] = WeakSet()
"""The guarded functions; an attribute would be copied by an author's ``functools.wraps``."""

_RAISED: dict[tuple[str, str], type[FlipperctlError]] = {
    ("network", "build"): ConfigError,
    ("network", "frames"): ConfigError,
    ("reward", "bounds"): PluginError,
}
"""(kind, method) → the error that rejects a plugin before it is used."""
_REFUSALS: dict[tuple[str, str], type[FlipperctlError]] = {
    ("terrain", "at"): TerrainError,
    ("terrain", "generate"): TerrainError,
    ("terrain", "labelled"): TerrainError,
}
"""(kind, method) → the error in place of a ValueError, with which the method rejects a request."""
_PASSED_ON: dict[str, type[BaseException]] = {"notices": ValueError, "open": BaseException}
"""Method → the errors that it passes on unchanged because the caller interprets them."""
_NO_PLUGINS = (float, int, bool, tuple, type(None))
"""Types of results that need no guard."""
_NAMES = {"labelled": "generate"}
"""Method of the contract → the author's method that it calls, which errors name."""


def guard_class(cls: type[Plugin]) -> None:
    """Guard each method and property of the contract, also inherited ones; idempotent."""
    for name in _contract(cls):
        found = next(vars(base)[name] for base in cls.__mro__ if name in vars(base))
        replaced = _guard_attribute(name, found)
        if replaced is not found:
            setattr(cls, name, replaced)


def _contract(cls: type[Plugin]) -> Iterator[str]:
    """Yield the public names that the contract's base classes of a plugin define."""
    for base in cls.__mro__:
        if base.__module__.startswith(_CONTRACT) and issubclass(base, Plugin):
            yield from (name for name in vars(base) if name[0] != "_" or name == "__call__")


def _guard_attribute(name: str, found: Any) -> object:
    """Return a guarded version of a method or property; return a plain value unchanged."""
    if isinstance(found, property) and found.fget is not None:
        getter = _guard(name, found.fget)
        return found if getter is found.fget else property(getter, doc=found.__doc__)
    if inspect.isfunction(found):
        return _guard(name, found)
    if isinstance(found, classmethod) and inspect.isfunction(found.__func__):
        method = _guard(name, found.__func__)
        return found if method is found.__func__ else classmethod(method)
    if not hasattr(type(found), "__get__"):
        return found
    if isinstance(found, functools.cached_property):
        return property(_guard(name, _bound(found)), doc=found.__doc__)

    @functools.wraps(_bound(found))
    def call(self: Plugin, *given: object, **named: object) -> object:
        """Call a static or partial method, or a compiled function."""
        method: Callable[..., object] = found.__get__(self, type(self))
        return method(*given, **named)

    return _guard(name, call)


def _bound(descriptor: Any) -> Callable[[Plugin], object]:
    """Return a function that returns a descriptor's value for a plugin."""

    @functools.wraps(getattr(descriptor, "func", descriptor))
    def get(self: Plugin) -> object:
        return descriptor.__get__(self, type(self))

    return get


def _guard(name: str, function: Callable[..., object]) -> Callable[..., object]:
    """Return a version of the function that names its plugin if it fails in a call by the core."""
    if function in _guarded:
        return function
    shown = _NAMES.get(name, name)

    @functools.wraps(function)
    def guarded(self: Plugin | type[Plugin], *given: object, **named: object) -> object:
        try:
            result = function(self, *given, **named)
        except BaseException as error:
            if isinstance(error, _PASSED_ON.get(name, ())) or not is_called_by_core(error):
                raise
            refuses = isinstance(error, ValueError)
            key = self.kind, name
            if refuses and (refusal := _REFUSALS.get(key)):
                raise_named(error, self, shown, refusal, plain=True)
            raise_named(error, self, shown, _RAISED.get(key, PluginFailedError))
        # Most results are numbers, of which the type is known sooner than that they are no plugin.
        if result.__class__ not in _NO_PLUGINS and isinstance(result, Plugin):
            guard_class(type(result))
        return result

    _guarded.add(guarded)
    return guarded
