"""The identity of a plugin: its name, non-default settings and the contents of its files.

In: a plugin. Out: plain data that does not depend on the place of a file, the notation of its path,
or settings with defaults that a later version adds. Also: the settings in which two plain
configurations differ.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
import marshal
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from flipperctl.api import Plugin, Range
from flipperctl.config.resolver import nested_plugins, to_dict
from flipperctl.errors import ConfigError
from flipperctl.plugging import guard

_COUNTS = ("steps", "hurdles", "plates", "piles", "bars", "blocks", "waves", "obstacles")
"""Ranges of the number of a terrain's parts."""


def identity(plugin: Plugin) -> dict[str, Any]:
    """Return the plugin's registered name, revision, non-default settings and files.

    A setting that names files that the plugin reads (same last component of the path) is left out;
    the SHA-256 of each file is included instead. Plugins in settings are described in the same way.
    A range is described by both ends, as ever, since the seeds of evaluations follow from this.
    """
    # Only what differs from a default counts, so that a later version may add settings.
    files, plain = read_files(plugin), to_dict(plugin)
    names = {file.name for file in files}
    settings: dict[str, Any] = {}
    for name, field in type(plugin).model_fields.items():
        value = getattr(plugin, name)
        default = field.get_default(call_default_factory=True, validated_data={})
        if isinstance(value, Range) and isinstance(default, Range):
            ends = zip(_ends(plugin.plugin_name, name), value, default, strict=True)
            settings |= {end: number for end, number, usual in ends if number != usual}
        elif value != default and not _names_files(value, names):
            settings[name] = _describe(value, plain[name])

    # What else decides results: the revision of the plugin, and the content of its files
    description = {"name": plugin.plugin_name, "settings": settings}
    if plugin.revision:
        description["revision"] = plugin.revision
    return description | ({"files": [content_digest(file) for file in files]} if files else {})


def _ends(owner: str, name: str) -> tuple[str, str]:
    """Return the names by which seeds and hashes know the ends of a range, as in version 0.2."""
    if name in _COUNTS:
        return "fewest", "most"
    before = "" if name == "height" and owner in ("step", "paper_step") else f"{name}_"
    return f"{before}low", f"{before}high"


def read_files(plugin: Plugin) -> tuple[Path, ...]:
    """Return the files that the plugin reads, and every path in its settings."""
    with guard.refusing(plugin, "files_read", ConfigError):
        listed: object = plugin.files_read()
    files = tuple(listed) if isinstance(listed, Iterable) else (listed,)
    if not all(isinstance(file, Path) for file in files):
        text = f"returned {guard.short_repr(listed)}; allowed: Paths"
        raise guard.refusal(plugin, "files_read", text)
    return tuple(dict.fromkeys((*files, *_paths([value for _, value in plugin]))))


def _paths(value: object) -> Iterator[Path]:
    """Yield the paths in a setting, at any depth; plugins in settings have their own."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, BaseModel) and not isinstance(value, Plugin):
        yield from _paths([inner for _, inner in value])
    elif isinstance(value, Mapping):
        yield from _paths(list(value.values()))
    elif isinstance(value, list | tuple | set | frozenset):
        for inner in value:
            yield from _paths(inner)


def all_files_read(plugins: Iterable[Plugin]) -> list[Path]:
    """Return the files that plugins and the plugins in their settings read, in order."""
    return [
        file for plugin in plugins for part in nested_plugins(plugin) for file in read_files(part)
    ]


def content_digest(file: Path) -> str | None:
    """Return the SHA-256 of the content of a file, or of the files below a folder by their names.

    None if it cannot be read, as its reader reports.
    """
    try:
        if file.is_dir():
            inner = sorted(path for path in file.rglob("*") if path.is_file())
            named = [f"{path.relative_to(file)} {content_digest(path)}" for path in inner]
            return hashlib.sha256("\n".join(named).encode()).hexdigest()
        with file.open("rb") as opened:
            return hashlib.file_digest(opened, "sha256").hexdigest()
    except OSError:
        return None


def foreign_sources(plugins: Iterable[Plugin]) -> list[str | None]:
    """Return the SHA-256 of the module of each plugin that is not part of flipperctl, in order.

    Plugins within settings are included. Of flipperctl's own, the version tells them apart. Files
    beside a plugin's own that it imports count too.
    """
    all_digests = []
    for plugin in foreign_plugins(plugins):
        digests = [content_digest(file) for file in _sources(type(plugin).__module__, {})]
        digests = digests or [_code_digest(type(plugin))]
        several = hashlib.sha256(" ".join(map(str, digests)).encode()).hexdigest()
        all_digests.append(several if len(digests) > 1 else next(iter(digests), None))
    return all_digests


def _code_digest(cls: type[Plugin]) -> str:
    """Return the SHA-256 of the methods of a class without a file, as of a notebook."""
    functions = (inspect.unwrap(value) for value in vars(cls).values() if callable(value))
    codes = [marshal.dumps(f.__code__) for f in functions if inspect.isfunction(f)]
    return hashlib.sha256(b"".join(codes)).hexdigest()


def foreign_plugins(plugins: Iterable[Plugin]) -> list[Plugin]:
    """Return the plugins, those within settings included, that are not part of flipperctl."""
    parts = (part for plugin in plugins for part in nested_plugins(plugin))
    return [part for part in parts if not guard.is_built_in(part)]


def _sources(name: str, files: dict[str, Path]) -> Iterable[Path]:
    """Return the file of a module, and the files beside it that it imports, at any depth.

    A module of an installed package stands alone.
    """
    file = getattr(sys.modules.get(name), "__file__", None)
    if name in files or file is None:
        return files.values()
    files[name] = Path(file)
    # Files beside a plugin's own count only where the plugin was given as a file.
    if name.startswith(guard.USER_MODULE):
        for node in ast.walk(ast.parse(Path(file).read_bytes())):
            if isinstance(node, ast.ImportFrom) and node.level:
                base = "." * node.level + (node.module or "")
                imported = importlib.util.resolve_name(base, sys.modules[name].__package__)
                for inner in (imported, *(f"{imported}.{alias.name}" for alias in node.names)):
                    _sources(inner, files)
    return files.values()


class _Absent:
    def __str__(self) -> str:
        return "none"


ABSENT = _Absent()
"""What ``differences`` yields for a key that only the other configuration has."""


def differences(here: Any, there: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield the path of each setting in which two plain configurations differ, and both values.

    ``path``: their place in the whole configuration. Lists of equal length are compared item by
    item if the items are sections, as in ``terrain.terrains[1].height``. A null counts as absent.
    """
    if isinstance(here, Mapping) and isinstance(there, Mapping):
        # A key of one side alone is yielded with ABSENT, unless it is null on the other.
        for key in {**here, **there}:
            inner = f"{path}.{key}" if path else str(key)
            yield from differences(here.get(key, ABSENT), there.get(key, ABSENT), inner)
    elif _are_sections(here) and _are_sections(there) and len(here) == len(there):
        for index, (first, second) in enumerate(zip(here, there, strict=True)):
            yield from differences(first, second, f"{path}[{index}]")
    elif here != there and not (here in (None, ABSENT) and there in (None, ABSENT)):
        yield path, here, there


def _are_sections(value: object) -> bool:
    return isinstance(value, list | tuple) and all(isinstance(item, Mapping) for item in value)


def _names_files(value: object, names: set[str]) -> bool:
    """Return whether the value is a path, or a list of paths, of files with these names."""
    parts = value if isinstance(value, tuple | list) else (value,)
    paths = [part for part in parts if isinstance(part, str | Path) and Path(part).name in names]
    return 0 < len(paths) == len(parts)


def _describe(value: object, plain: Any) -> Any:
    """Return the plain data of a value, with the identity of each plugin in it."""
    if isinstance(value, Plugin):
        return identity(value)
    if isinstance(value, tuple | list):
        return [_describe(v, p) for v, p in zip(value, plain, strict=True)]
    if isinstance(value, Mapping):
        return {k: _describe(v, p) for (k, v), p in zip(value.items(), plain.values(), strict=True)}
    return plain
