"""Finds plugins, imports them, and makes instances of them from configuration.

In: the entry-point group ``flipperctl.plugins``, ``FLIPPERCTL_PLUGINS`` and paths given on the
command line. Out: ``api.registry`` filled, and frozen plugin instances.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from pydantic import ValidationError
from pydantic_core import PydanticSerializationError

from flipperctl import guard
from flipperctl.api import Plugin, registry
from flipperctl.errors import ConfigError, PluginError
from flipperctl.messages import close_match, explain

GROUP = "flipperctl.plugins"
VARIABLE = "FLIPPERCTL_PLUGINS"

_loaded: set[str] = set()


def load(paths: Iterable[str | Path] = ()) -> None:
    """Import every installed plugin, those of ``FLIPPERCTL_PLUGINS``, and those at ``paths``.

    ``paths`` (``.py`` files or folders) are added to the variable, so that worker processes
    find them too. Calling it again imports only what is new.

    Raises:
        PluginError: a plugin is missing, does not import, registers nothing, or takes a name.
    """
    for entry in sorted(entry_points(group=GROUP), key=lambda e: (e.name, e.value)):
        if entry.value not in _loaded:
            _importing(entry.value, f"entry point {entry.name!r}", None, entry.load)
    named = [*given(), *(str(Path(p).absolute()) for p in paths)]
    named = list(dict.fromkeys(named))
    for path in named:
        for file in _files(Path(path)):
            _load_file(file)
    if named:
        os.environ[VARIABLE] = os.pathsep.join(named)


def given() -> list[str]:
    """The paths in ``FLIPPERCTL_PLUGINS``; after ``load``, also those it was called with."""
    return [p for p in os.environ.get(VARIABLE, "").split(os.pathsep) if p]


def _files(path: Path) -> list[Path]:
    if path.is_file() and path.suffix == ".py":
        return [path]
    if path.is_dir():
        files = sorted(f for f in path.glob("*.py") if not f.name.startswith("_"))
        if files:
            return files
        raise PluginError(f"plugins: {path} holds no .py file")
    what = "is no .py file" if path.exists() else "does not exist"
    raise PluginError(f"plugins: {path} {what}; a .py file or a folder of them is allowed")


def _load_file(file: Path) -> None:
    file = file.resolve()
    digest = hashlib.sha256(str(file).encode()).hexdigest()[:8]
    name = f"flipperctl_user_{file.stem}_{digest}"
    if name in _loaded:
        return

    def run() -> ModuleType:
        spec = importlib.util.spec_from_file_location(name, file)
        if spec is None or spec.loader is None:
            raise ImportError(f"{file} cannot be imported as Python")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
        return module

    _importing(name, str(file), file, run)


def _importing(name: str, shown: str, file: Path | None, run: Callable[[], object]) -> None:
    before = dict(registry)
    fresh = name not in sys.modules
    try:
        run()
    except BaseException as error:  # SystemExit too: to leave is not a plugin's business
        registry.clear()
        registry.update(before)
        sys.modules.pop(name, None)
        if isinstance(error, KeyboardInterrupt):
            raise
        raise PluginError(f"plugin {shown} does not import: {_where(error, file)}") from error
    if fresh and len(registry) == len(before):
        sys.modules.pop(name, None)
        raise PluginError(
            f"plugin {shown} registers nothing; "
            "decorate a class with @terrain, @reward, @network or @controller"
        )
    _loaded.add(name)


def _where(error: BaseException, file: Path | None) -> str:
    """File and line of the plugin's own that led to the error, and the error."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}: {error.msg}"
    found = guard.import_place(error, file)
    return f"{found}: {guard.error_line(error)}" if found else guard.error_line(error)


def names(kind: str) -> list[str]:
    """The registered names of one family, sorted."""
    return sorted(name for k, name in registry if k == kind)


def get(kind: str, name: object, where: str) -> type[Plugin]:
    """The class registered under ``name``.

    Raises:
        ConfigError: no plugin of that kind has the name; the text has a close match.
    """
    found = registry.get((kind, str(name)))
    if found is None:
        raise ConfigError(
            f"{where}: there is no {kind} plugin {name!r}{close_match(str(name), names(kind))}; "
            f"registered: {', '.join(names(kind)) or 'none'}"
        )
    return found


def create(kind: str, settings: object, where: str) -> Any:
    """A plugin instance from its name, or from a mapping with ``name`` and its fields.

    Raises:
        ConfigError: the name is unknown, or a field is unknown, of the wrong type or out of bounds.
    """
    if isinstance(settings, Plugin):
        if not hasattr(type(settings), "plugin_name"):
            raise ConfigError(
                f"{where}: {type(settings).__name__} is not registered; "
                f"decorate it with @{kind}(<name>)"
            )
        return settings
    if isinstance(settings, str):
        settings = {"name": settings}
    if not isinstance(settings, Mapping) or "name" not in settings:
        raise ConfigError(
            f"{where}: a plugin's name, or a mapping with 'name' and its fields, "
            f"is allowed; got {settings!r}"
        )
    fields = {k: v for k, v in settings.items() if k != "name"}
    cls = get(kind, settings["name"], where)
    try:
        return construct(cls, fields)
    except ValidationError as error:
        raise ConfigError(explain(error, where, cls, fields)) from error


def construct(cls: type[Plugin], fields: Mapping[str, Any]) -> Plugin:
    """An instance of a plugin.

    Raises:
        ValidationError: a field is unknown, of the wrong type or out of bounds.
        PluginError: the plugin's own code raised anything else.
    """
    try:
        return cls(**fields)
    except BaseException as error:
        own_title = cls.model_config.get("title") or cls.__name__
        if isinstance(error, ValidationError) and error.title == own_title:
            raise  # not that of another model that the plugin's code made
        raise guard.fault(error, cls, "its construction", PluginError) from error


def container(plugin: Plugin, *, brief: bool = False) -> dict[str, Any]:
    """The mapping from which ``create`` makes an equal instance.

    ``brief``: a plugin within it that has all its defaults is its name alone.

    Raises:
        PluginError: a field cannot be written as JSON.
    """
    try:
        fields = plugin.model_dump(mode="json", context={"brief": brief})
    except BaseException as error:
        # pydantic wraps what a serialiser raises, that of a plugin within this one too.
        wrapped = isinstance(error, PydanticSerializationError) and error.__cause__
        cause = wrapped or error
        raise guard.fault(cause, plugin, "its serialisation", PluginError) from error
    return {"name": plugin.plugin_name, **fields}


def defaults(cls: type[Plugin]) -> dict[str, Any]:
    """The brief container of a plugin that is given nothing but its name.

    Raises:
        ConfigError: a field has no default, or a default that is not valid.
        PluginError: the plugin's own code raised anything else.
    """
    try:
        return container(construct(cls, {}), brief=True)
    except ValidationError as error:
        raise ConfigError(
            f"{guard.plugin_label(cls)}: its defaults are not valid: "
            f"{explain(error, '', cls)} ({guard.definition(cls)})"
        ) from error


def nested(plugin: Plugin) -> list[Plugin]:
    """The plugin and those in its fields, at any depth."""
    found, waiting = [plugin], [getattr(plugin, name) for name in type(plugin).model_fields]
    while waiting:
        value = waiting.pop(0)
        if isinstance(value, Plugin):
            found += nested(value)
        elif isinstance(value, tuple | list):
            waiting += value
        elif isinstance(value, Mapping):
            waiting += value.values()
    return found


def source(cls: type[Plugin]) -> str:
    """Where a plugin was defined: its file, or its module for what has none."""
    return guard.definition(cls)
