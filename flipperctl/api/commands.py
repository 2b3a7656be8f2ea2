"""Subcommands: functions whose parameters are what is typed after ``flipperctl NAME``."""

from __future__ import annotations

import types
from collections.abc import Callable
from typing import Any, ClassVar, TypeVar

from flipperctl.api.plugin import Plugin, register


class Subcommand(Plugin):
    """A subcommand; ``command`` makes one of a function."""

    kind: ClassVar[str] = "command"
    run: ClassVar[Callable[..., int | None]]
    """The function. Its parameters are arguments and options, as typer reads them; what it returns
    is the exit code, None for 0."""


FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])


def command(name: str) -> Callable[[FunctionT], FunctionT]:
    """Register a function as ``flipperctl NAME``; ``"robot check"`` is ``check`` in a group.

    The docstring is the help. The option ``--plugins`` is added to the function's parameters.

    Raises:
        ValueError: the name is not valid or is already taken.
        TypeError: what is decorated is no function.
    """
    registered = register(Subcommand, name)

    def decorate(function: FunctionT) -> FunctionT:
        registered(command_class(function))
        return function

    return decorate


def command_class(function: Callable[..., Any]) -> type[Subcommand]:
    """Return the plugin of a function, which is not registered yet."""
    if not isinstance(function, types.FunctionType):
        raise TypeError(f"a function is allowed as a command, not {function!r:.60}")
    named = {key: getattr(function, key) for key in ("__doc__", "__module__", "__qualname__")}
    body = {**named, "run": staticmethod(function)}
    return types.new_class(function.__name__, (Subcommand,), exec_body=lambda ns: ns.update(body))
