"""Print notices once per command, on stderr: of plugins about their data, and on sampled robots.

In: a validated configuration. Out: a line for each notice.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

from flipperctl import guard
from flipperctl.api import Plugin
from flipperctl.config import EnvConfig, resolver
from flipperctl.config.defaults import notes_on_robot

_printed: set[str] = set()


def begin() -> None:
    """Forget the printed notices, at the start of a command."""
    _printed.clear()


def print_notices(config: EnvConfig) -> None:
    """Print the notices on a configuration that this command has not printed yet."""
    for plugin in _plugins(config):
        for notice in _notices(plugin):
            _print(f"{guard.plugin_label(plugin)}: {notice}")
    for note in notes_on_robot(config):
        _print(note)


def _print(notice: str) -> None:
    text = f"warning: {notice}"
    if text not in _printed:
        _printed.add(text)
        print(text, file=sys.stderr)


def _plugins(config: EnvConfig) -> Iterator[Plugin]:
    for value in (getattr(config, name) for name in type(config).model_fields):
        for item in value.values() if isinstance(value, dict) else (value,):
            if isinstance(item, Plugin):
                yield from resolver.nested_plugins(item)


def _notices(plugin: Plugin) -> tuple[str, ...]:
    try:
        return plugin.notices()
    except ValueError:
        return ()  # the use of the plugin raises the error that says why
