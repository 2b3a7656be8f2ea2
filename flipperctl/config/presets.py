"""Finds named sets of settings in files of flipperctl and beside plugins, by one rule.

In: a group, such as ``suite``. Out: its ``.yaml`` files by name, from the folder of the group in
``flipperctl.configs`` and in the folder of each plugin, whether it is installed or given by a path.
"""

from __future__ import annotations

from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from flipperctl.errors import ConfigError
from flipperctl.plugging import plugins

SUFFIX = ".yaml"


def groups() -> list[str]:
    """Return the groups that have presets."""
    return sorted(
        folder.name for folder in files("flipperctl.configs").iterdir() if folder.is_dir()
    )


def shipped(group: str) -> dict[str, Traversable]:
    """Return the presets of flipperctl by name, sorted."""
    return _inside(files("flipperctl.configs") / group)


def presets(group: str) -> dict[str, Traversable]:
    """Return the presets of flipperctl, then the presets beside plugins, by name.

    Raises:
        ConfigError: two have one name.
    """
    result = shipped(group)
    for folder in plugins.folders():
        for name, file in _inside(folder / group).items():
            if (other := result.setdefault(name, file)) != file:
                raise ConfigError(f"{group}: {other} and {file} have the same name; rename one")
    return result


def folders() -> list[Path]:
    """Return the folders of plugins that have presets, after a check of all their names."""
    for group in groups():
        presets(group)
    return [f for f in plugins.folders() if any((f / group).is_dir() for group in groups())]


def _inside(folder: Traversable) -> dict[str, Traversable]:
    inner = sorted(folder.iterdir(), key=lambda file: file.name) if folder.is_dir() else []
    return {file.name.removesuffix(SUFFIX): file for file in inner if file.name.endswith(SUFFIX)}
