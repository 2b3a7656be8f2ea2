"""Find plugins and import them; importing a plugin registers it.

In: the entry-point group ``flipperctl.plugins``, ``FLIPPERCTL_PLUGINS`` and paths given on the
command line. Out: ``api.registry``, from whose classes ``config.resolver`` makes instances.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import sys
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import cache_from_source
from pathlib import Path
from types import ModuleType
from typing import Any

from flipperctl.api import Plugin, command, registry
from flipperctl.api.plugin import Broken, broken
from flipperctl.errors import PluginError
from flipperctl.plugging import guard
from flipperctl.plugging.guard import USER_MODULE
from flipperctl.text.files import at_home
from flipperctl.text.messages import missing_name, suggestion

GROUP = "flipperctl.plugins"
COMMANDS = "flipperctl.commands"
"""Group of entry points that are functions: subcommands by name, ``.`` in place of a space."""
VARIABLE = "FLIPPERCTL_PLUGINS"

_loaded: set[str] = set()
_given: list[str] = []
"""Paths that ``load`` was called with or found in the variable, in this order."""
_contents: dict[str, tuple[Path, str]] = {}
"""The files that were loaded and their SHA-256, by the names of their modules."""
_files: dict[type[Plugin], str] = {}
"""Class → name of the file from which it was loaded, for plugins that are not installed."""


def load(paths: Iterable[str | Path] = ()) -> None:
    """Import every installed plugin, and the plugins in ``FLIPPERCTL_PLUGINS`` and at ``paths``.

    ``paths`` (``.py`` files or folders) are remembered for worker processes. A repeated call
    imports only new plugins, and files that have changed, whose plugins replace those of before.
    What is installed and does not load is left out, and listed in ``api.plugin.broken``.

    Raises:
        PluginError: a file is missing, does not import, registers nothing, or uses a name that is
            taken. One of an earlier call that fails now is forgotten instead.
    """
    # Installed plugins, each tried once
    load_installed()

    # Paths of this call must load; earlier ones that fail by now are forgotten.
    named = [str(Path(at_home(p)).absolute()) for p in paths]
    required = {*_in_variable(), *named}
    _given[:] = [
        path
        for path in dict.fromkeys([*configured_paths(), *named])
        if _load_path(Path(path), required=path in required)
    ]


def load_installed() -> None:
    """Import every installed plugin, and no file of a user."""
    _load_group(GROUP)


def load_commands() -> None:
    """Register the subcommands of installed packages, also those of flipperctl."""
    _load_group(COMMANDS)


def installed(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group, sorted by name, of all installed packages.

    The metadata of all packages is read once, and again if a folder of ``sys.path`` changes.
    """
    return _entries(group, tuple((place, _changed(place)) for place in sys.path))


@cache
def _entries(group: str, places: tuple[tuple[str, int], ...]) -> tuple[EntryPoint, ...]:
    return tuple(sorted(entry_points(group=group), key=lambda e: (e.name, e.value)))


def _changed(place: str) -> int:
    """Return when a folder changed last [ns]; 0 if it cannot be read."""
    try:
        return Path(place).stat().st_mtime_ns
    except OSError:
        return 0


def _load_group(group: str) -> None:
    for entry in installed(group):
        tried = entry.value in _loaded or entry.value in {package.module for package in broken}
        decorated = registry.get(("command", entry.name.replace(".", " ")))
        if not (tried or (decorated is not None and decorated.__module__ == entry.module)):
            _load_entry(entry)


def _load_entry(entry: EntryPoint) -> None:
    """Import an entry point; one that fails is remembered as broken."""
    package, registered = entry.dist.name if entry.dist else "?", dict(registry)
    tried: set[str] = set()

    def run() -> None:
        try:
            loaded = entry.load()
            if entry.group == COMMANDS:
                command(entry.name.replace(".", " "))(loaded)
        finally:
            tried.update(name for _, name in registry.keys() - registered.keys())

    label = f"{entry.name!r} of the installed package {package}"
    try:
        _import(entry.value, label, None, run)
    except PluginError as error:
        names = frozenset({entry.name.replace(".", " "), *tried})
        broken.append(Broken(entry.name, package, entry.value, names, str(error)))


def _load_path(path: Path, *, required: bool) -> bool:
    """Import the files at a path; return False for one that fails and is not required."""
    try:
        # A file without a plugin may be the neighbour that another one imports.
        empty: dict[Path, PluginError] = {}
        for file in _files_at(path):
            try:
                _load_file(file)
            except _EmptyError as error:
                empty[file] = error
        for file, refusal in empty.items():
            if _module_name(file.resolve()) not in _loaded:  # no neighbour imports it
                raise refusal
    except PluginError:
        if required:
            raise
        return False
    return True


def configured_paths() -> list[str]:
    """Return the paths in ``FLIPPERCTL_PLUGINS``; after ``load``, also those it was called with."""
    return list(dict.fromkeys([*_in_variable(), *_given]))


def _in_variable() -> list[str]:
    return [p for p in at_home(os.environ.get(VARIABLE, "")).split(os.pathsep) if p]


def folders() -> list[Path]:
    """Return the folders of the plugins at ``configured_paths`` and of installed ones."""
    places = [path if path.is_dir() else path.parent for path in map(Path, configured_paths())]
    for entry in installed(GROUP):
        file = getattr(sys.modules.get(entry.module), "__file__", None)
        if file is not None:
            places.append(Path(file).parent)
    return list(dict.fromkeys(places))


def loaded_contents() -> dict[Path, str]:
    """Return the files loaded by path, and the neighbours that they import, with their SHA-256."""
    return dict(sorted(item for module, item in _contents.items() if module in _loaded))


def packages() -> dict[str, list[tuple[str, str]]]:
    """Return kind and name of the plugins of each installed package and file, by its name."""
    load_commands()
    entries = (*installed(GROUP), *installed(COMMANDS))
    owners = {entry.module.partition(".")[0]: entry.dist.name for entry in entries if entry.dist}
    inside: dict[str, list[tuple[str, str]]] = {}
    for key, cls in sorted(registry.items()):
        module = cls.__module__.partition(".")[0]
        inside.setdefault(_files.get(cls) or owners.get(module, module), []).append(key)
    return inside


def plugin_keys(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return kind and name of each plugin of these names, or packages; of all without any."""
    inside, known = packages(), {plugin for _, plugin in registry}
    selected: set[tuple[str, str]] = set()
    for name in names:
        package = {_canonical(p): keys for p, keys in inside.items()}.get(_canonical(name), [])
        if not package and name not in known:
            also = [*known, *inside]
            raise PluginError(f"there is no plugin or package {name!r}{missing_name(name, also)}")
        selected |= {*package, *(key for key in registry if key[1] == name)}
    return sorted(selected if names else registry)


def _canonical(package: str) -> str:
    """Return the name of a package as its import writes it."""
    return package.lower().replace("-", "_")


def broken_plugins(names: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Return the entry points of installed packages that do not load, as ``describe`` does.

    Raises:
        PluginError: one of the names is theirs, and of no other plugin.
    """
    load_commands()
    known = {plugin for _, plugin in registry}
    for package in broken:
        for name in names:
            if name in package.names - known or _canonical(name) == _canonical(package.package):
                raise PluginError(f"{name}: {package.reason}")
    return [
        {
            "kind": "broken",
            "name": package.name,
            "summary": package.reason,
            "module": package.module,
            "source": package.reason,
            "fields": [],
        }
        for package in broken
    ]


def file_name(cls: type[Plugin]) -> str | None:
    """Return the name of the file that a plugin was loaded from; None for an installed plugin."""
    return _files.get(cls)


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
        fault += suggestion(named.name, quoted=False)
    raise PluginError(f"plugins: {path} {fault}; a .py file or a folder of them is allowed")


def _module_name(file: Path) -> str:
    """Return the name of a file's module in the package of its folder."""
    stem = file.stem
    if "." in stem:  # it would name a further package
        stem = f"{stem.replace('.', '_')}_{_digest(file)}"
    return f"{_package_name(file)}.{stem}"


def _package_name(file: Path) -> str:
    return f"{USER_MODULE}{_digest(file.parent)}"


def _digest(path: Path) -> str:
    return hashlib.sha256(str(path).encode()).hexdigest()[:8]


def _load_file(file: Path) -> None:
    """Import a file in the package of its folder, so that ``from .helper import …`` works in it."""
    file = file.resolve()
    name, package = _module_name(file), _package_name(file)
    neighbours = {m: content for m, content in _contents.items() if m.startswith(f"{package}.")}
    if any(_content(path) != content for path, content in neighbours.values()):
        _unload(neighbours)  # processes that begin from now on run other code, and so does this one
    if name in _loaded:
        return

    def run() -> ModuleType:
        spec = importlib.util.spec_from_file_location(name, file)
        if spec is None or spec.loader is None:
            raise ImportError(f"{file} cannot be imported as Python")
        if package not in sys.modules:
            sys.modules[package] = ModuleType(package)
            sys.modules[package].__path__ = [str(file.parent)]
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
        return module

    # What it brings: modules, their contents, and the file of each plugin
    before, modules = dict(registry), set(sys.modules) - {name}
    _import(name, str(file), file, run)
    for module in sorted(set(sys.modules) - modules):  # the file, and neighbours that it imports
        location = getattr(sys.modules[module], "__file__", None)
        if module.startswith(f"{package}.") and location is not None:
            _loaded.add(module)
            _contents[module] = Path(location), _content(Path(location))
    for key, cls in registry.items():
        if before.get(key) is not cls:
            _files[cls] = _contents.get(cls.__module__, (file, ""))[0].name


def _unload(modules: Collection[str]) -> None:
    """Forget modules of a folder and the plugins that they registered."""
    for key, cls in list(registry.items()):
        if cls.__module__ in modules:
            del registry[key]
    for module in modules:
        _loaded.discard(module)
        file, _ = _contents.pop(module)
        _forget(module)
        # Python takes compiled code for that of a file of the same size and second.
        with suppress(OSError, NotImplementedError):
            Path(cache_from_source(file)).unlink(missing_ok=True)


def _content(file: Path) -> str:
    """Return the SHA-256 of a file; of one that cannot be read, which does not import, nothing."""
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return ""


class _EmptyError(PluginError):
    """A file registers nothing."""


def _import(name: str, label: str, file: Path | None, run: Callable[[], object]) -> None:
    before, modules = dict(registry), set(sys.modules)
    fresh = name not in modules
    try:
        run()
    except BaseException as error:  # SystemExit too: a plugin must not end the process
        # A half-imported plugin leaves nothing behind.
        registry.clear()
        registry.update(before)
        _forget(name, *(set(sys.modules) - modules))
        if isinstance(error, KeyboardInterrupt):
            raise
        raise PluginError(
            f"plugin {label} does not import: {_describe_failure(error, file, name)}"
        ) from error
    if fresh and len(registry) == len(before):
        _forget(name, *(set(sys.modules) - modules))
        raise _EmptyError(
            f"plugin {label} registers nothing; "
            "decorate a class with @terrain, @reward, @network, @controller, @engine, @sensor, "
            "@measure or @logger, or a function with @command"
        )
    _loaded.add(name)


def _forget(name: str, *others: str) -> None:
    """Let a module, and the modules beside it that it imported, be imported anew."""
    for module in (name, *(other for other in others if other.startswith(USER_MODULE))):
        sys.modules.pop(module, None)
        package, _, leaf = module.rpartition(".")
        if package in sys.modules:
            vars(sys.modules[package]).pop(leaf, None)


def _describe_failure(error: BaseException, file: Path | None, name: str) -> str:
    """Return the file and line in the plugin that led to the error, and the error."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}: {error.msg}"
    place = guard.place(error, name.partition(".")[0])
    text = f"{place}: {guard.error_line(error)}" if place else guard.error_line(error)
    missing = error.name if isinstance(error, ModuleNotFoundError) and error.name else ""
    if file is not None and missing and (file.parent / f"{missing}.py").is_file():
        text += f"; {missing}.py lies beside it: write from .{missing} import …"
    return text
