"""Find plugins and import them; importing a plugin registers it.

In: the entry-point group ``flipperctl.plugins``, ``FLIPPERCTL_PLUGINS`` and paths given on the
command line. Out: ``api.registry``, from whose classes ``config.resolver`` makes instances.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import re
import sys
from collections.abc import Callable, Iterable
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

from flipperctl import guard
from flipperctl.api import Plugin, registry
from flipperctl.errors import PluginError

GROUP = "flipperctl.plugins"
VARIABLE = "FLIPPERCTL_PLUGINS"

MODULE = "flipperctl_user_"
"""Prefix of the names of modules that were loaded from a path."""

_loaded: set[str] = set()
_given: list[str] = []
"""Paths that ``load`` was called with or found in the variable, in this order."""
_contents: dict[str, str] = {}
"""SHA-256 of the files that were loaded, by the names of their modules."""
_files: dict[type[Plugin], str] = {}
"""Class → name of the file from which it was loaded, for plugins that are not installed."""


def load(paths: Iterable[str | Path] = ()) -> None:
    """Import every installed plugin, those in ``FLIPPERCTL_PLUGINS`` and those at ``paths``.

    ``paths`` (``.py`` files or folders) are remembered for worker processes. A repeated call
    imports only new plugins.

    Raises:
        PluginError: a plugin is missing, does not import, registers nothing, or uses a
            name that is taken.
    """
    for entry in sorted(entry_points(group=GROUP), key=lambda e: (e.name, e.value)):
        if entry.value not in _loaded:
            package = entry.dist.name if entry.dist else "?"
            label = f"{entry.name!r} of the installed package {package}"
            _import(entry.value, label, None, entry.load)
    named = [*configured_paths(), *(str(Path(p).absolute()) for p in paths)]
    named = list(dict.fromkeys(named))
    for path in named:
        for file in _files_at(Path(path)):
            _load_file(file)
    _given[:] = named


def configured_paths() -> list[str]:
    """Return the paths in ``FLIPPERCTL_PLUGINS``; after ``load``, also those it was called with."""
    named = [p for p in os.environ.get(VARIABLE, "").split(os.pathsep) if p]
    return list(dict.fromkeys([*named, *_given]))


def folders() -> list[Path]:
    """Return the folders of the plugins at ``configured_paths`` and of those that are installed."""
    found = [path if path.is_dir() else path.parent for path in map(Path, configured_paths())]
    for entry in entry_points(group=GROUP):
        file = getattr(sys.modules.get(entry.module), "__file__", None)
        if file is not None:
            found.append(Path(file).parent)
    return list(dict.fromkeys(found))


def file_name(cls: type[Plugin]) -> str | None:
    """Return the name of the file that a plugin was loaded from; None for an installed plugin."""
    return _files.get(cls)


def module_file_name(module: str) -> str | None:
    """Return the name of the file that a module was loaded from by path; None for any other."""
    found = re.fullmatch(rf"{MODULE}(.+)_[0-9a-f]{{8}}", module)
    return f"{found[1]}.py" if found else None


def _files_at(path: Path) -> list[Path]:
    if path.is_file() and path.suffix == ".py":
        return [path]
    if path.is_dir():
        files = sorted(f for f in path.glob("*.py") if not f.name.startswith("_"))
        if files:
            return files
        raise PluginError(f"plugins: {path} holds no .py file")
    fault = "is not a .py file" if path.exists() else "does not exist"
    if (named := path.with_name(f"{path.name}.py")).is_file():
        fault += f"; did you mean {named.name}?"
    raise PluginError(f"plugins: {path} {fault}; a .py file or a folder of them is allowed")


def _load_file(file: Path) -> None:
    file = file.resolve()
    digest = hashlib.sha256(str(file).encode()).hexdigest()[:8]
    name = f"{MODULE}{file.stem}_{digest}"
    content = _content(file)
    if name in _loaded:
        if content != _contents[name]:  # processes that begin from now on would run other code
            raise PluginError(
                f"plugins: {file} has changed since it was loaded here; start Python again"
            )
        return

    def run() -> ModuleType:
        spec = importlib.util.spec_from_file_location(name, file)
        if spec is None or spec.loader is None:
            raise ImportError(f"{file} cannot be imported as Python")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
        return module

    before = dict(registry)
    _import(name, str(file), file, run)
    fresh = (cls for key, cls in registry.items() if before.get(key) is not cls)
    _files.update(dict.fromkeys(fresh, file.name))
    _contents[name] = content


def _content(file: Path) -> str:
    """Return the SHA-256 of a file; of one that cannot be read, which does not import, nothing."""
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return ""


def _import(name: str, label: str, file: Path | None, run: Callable[[], object]) -> None:
    before = dict(registry)
    fresh = name not in sys.modules
    try:
        run()
    except BaseException as error:  # SystemExit too: a plugin must not end the process
        registry.clear()
        registry.update(before)
        sys.modules.pop(name, None)
        if isinstance(error, KeyboardInterrupt):
            raise
        raise PluginError(
            f"plugin {label} does not import: {_describe_failure(error, file)}"
        ) from error
    if fresh and len(registry) == len(before):
        sys.modules.pop(name, None)
        raise PluginError(
            f"plugin {label} registers nothing; "
            "decorate a class with @terrain, @reward, @network, @controller, @engine, @sensor, "
            "@measure or @logger"
        )
    _loaded.add(name)


def _describe_failure(error: BaseException, file: Path | None) -> str:
    """Return the file and line in the plugin that led to the error, and the error."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}: {error.msg}"
    found = guard.import_place(error, file)
    return f"{found}: {guard.error_line(error)}" if found else guard.error_line(error)
