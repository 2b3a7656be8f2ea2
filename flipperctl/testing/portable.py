"""Find what the code of a class needs beyond Python, numpy and ``flipperctl.core``.

In: a class. Out: the names of modules and objects that a robot's computer may lack.
"""

from __future__ import annotations

import dis
import sys
from collections.abc import Iterator
from types import CodeType, FunctionType, ModuleType

_PRESENT = (*sys.stdlib_module_names, "numpy", "flipperctl.core")


def foreign_names(cls: type) -> set[str]:
    """Return the foreign names that the class's methods use, directly or via its module."""
    return set(_foreign(cls, cls.__module__, set()))


def _foreign(value: object, home: str, seen: set[int]) -> Iterator[str]:
    if id(value) in seen:
        return
    seen.add(id(value))
    module = value.__name__ if isinstance(value, ModuleType) else _module(value)
    if module != home:
        if not any(module == name or module.startswith(f"{name}.") for name in _PRESENT):
            yield module if isinstance(value, ModuleType) else f"{module}.{_name(value)}"
    elif isinstance(value, type):
        for part in (*value.__bases__, *vars(value).values()):
            yield from _foreign(_function(part), home, seen)
    elif isinstance(value, FunctionType):
        for name in _globals(value.__code__):
            if name in value.__globals__:
                yield from _foreign(_function(value.__globals__[name]), home, seen)
        for name in _imports(value.__code__):
            yield from _foreign(ModuleType(name), home, seen)


def _globals(code: CodeType) -> set[str]:
    """Return the global names that a function and those inside it use."""
    found = {i.argval for i in dis.get_instructions(code) if i.opname == "LOAD_GLOBAL"}
    return found.union(*(_globals(c) for c in code.co_consts if isinstance(c, CodeType)))


def _imports(code: CodeType) -> set[str]:
    """Return the modules that a function and those inside it import."""
    found = {i.argval for i in dis.get_instructions(code) if i.opname == "IMPORT_NAME"}
    return found.union(*(_imports(c) for c in code.co_consts if isinstance(c, CodeType)))


def _function(part: object) -> object:
    """Return the function that a property, method, cache or partial wraps; others unchanged."""
    if isinstance(part, FunctionType | ModuleType | type):
        return part
    inner = (getattr(part, name, None) for name in ("fget", "__func__", "__wrapped__", "func"))
    return next((_function(one) for one in inner if callable(one)), part)


def _module(value: object) -> str:
    """Return the module that defines a class or a function, or the class of any other value."""
    named = isinstance(value, type | FunctionType)
    return str(getattr(value if named else type(value), "__module__", "builtins"))


def _name(value: object) -> str:
    return str(getattr(value, "__qualname__", type(value).__qualname__))
