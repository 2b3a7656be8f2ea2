"""Subcommands that are plugins: found by their names, imported when they are needed.

In: the entry-point group ``flipperctl.commands``, and what plugin files have registered. Out:
functions, with the option ``--plugins`` among their parameters.
"""

from __future__ import annotations

import functools
import inspect
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from flipperctl.cli import options
from flipperctl.errors import FlipperctlError, PluginError
from flipperctl.terminal.streams import print_note

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Words = tuple[str, ...]
"""What is typed after ``flipperctl``: a name, or a group and a name in it."""
GROUP = "flipperctl.commands"
"""Entry points; in their names a dot separates the group, as in ``robot.check``."""
_VARIABLE = "FLIPPERCTL_PLUGINS"
_OWN = "flipperctl."
"""Begin of the modules whose functions need no registry."""


def names(group: Words) -> list[str]:
    """Return the names in a group of subcommands, sorted."""
    inside = [words for words in (*_installed(), *_registered()) if words[: len(group)] == group]
    return sorted({words[len(group)] for words in inside if len(words) > len(group)})


def function(words: Words) -> Callable[..., Any]:
    """Return the function of a subcommand.

    Raises:
        LookupError: there is none; it may be a group.
        PluginError: it does not import.
    """
    if words in (registered := _registered()):
        return registered[words]

    # A stranger's command that does not load says so as other plugins do.
    entry = _installed()[words]
    try:
        run: Callable[..., Any] = entry.load()
    except Exception as error:  # importing a stranger's module may raise anything
        if entry.module.startswith(_OWN):
            raise
        from flipperctl.plugging import plugins

        plugins.load_commands()
        plugins.broken_plugins([" ".join(words)])  # which raises its reason
        raise PluginError(f"the command {' '.join(words)} does not load: {error}") from error
    # Errors of its code name the plugins that are registered.
    if not entry.module.startswith(_OWN) and words not in _registered():
        from flipperctl.api import command

        command(" ".join(words))(run)
    return run


def with_plugins(run: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that takes ``--plugins``, as every command does."""
    signature = inspect.signature(run, eval_str=True)

    @functools.wraps(run)
    def command(*, plugins: object = None, **values: Any) -> Any:
        return run(**values)

    extra = inspect.Parameter(
        "plugins", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=options.PluginPaths
    )
    parameters = [*signature.parameters.values(), extra]
    vars(command)["__signature__"] = signature.replace(parameters=parameters)
    return command


def help_text(group: Words) -> str:
    """Return the help of a group: the docstring of the module of its first subcommand."""
    run = inspect.unwrap(function((*group, names(group)[0])))
    return inspect.cleandoc(sys.modules[run.__module__].__doc__ or "").partition("\n\n")[0]


def load_files(arguments: Sequence[str]) -> None:
    """Load the plugins of ``--plugins`` among the words that were typed, and all installed ones."""
    from flipperctl.plugging import plugins

    words = iter(arguments)
    paths = []
    for word in words:
        name, equals, value = word.partition("=")
        if name == "--plugins":
            paths.append(value if equals else next(words, ""))
    plugins.load(filter(None, paths))


def load_variable() -> None:
    """Load the plugins of ``FLIPPERCTL_PLUGINS``, whose commands help then lists."""
    if os.environ.get(_VARIABLE):
        try:
            load_files(())
        except FlipperctlError as error:
            print_note(f"warning: {error}")


@functools.cache
def _installed() -> Mapping[Words, EntryPoint]:
    from importlib.metadata import entry_points  # which commands of the package do not wait for

    return {tuple(entry.name.split(".")): entry for entry in entry_points(group=GROUP)}


def _registered() -> dict[Words, Callable[..., Any]]:
    """Return the functions of plugins that were loaded; listing the others loads none."""
    if "flipperctl.api" not in sys.modules:
        return {}
    from flipperctl.api import Subcommand, registry

    commands = {name: cls for (_, name), cls in registry.items() if issubclass(cls, Subcommand)}
    return {tuple(name.split()): cls.run for name, cls in commands.items()}
