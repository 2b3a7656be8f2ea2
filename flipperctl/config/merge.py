"""Change plain settings by their keys: the one merge of commands, Python, resumed runs, map points.

In: nested mappings, dotted keys, plain values. Out: the same mappings, changed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from flipperctl.api import Plugin, Settings
from flipperctl.config.resolver import loggers_by_name, named_robot, parse, to_dict
from flipperctl.errors import ConfigError

SettingsT = TypeVar("SettingsT", bound=Settings)
MISSING = object()
"""What ``find`` returns for a key that does not exist."""


def find(plain: Mapping[str, Any], key: str) -> Any:
    """Return the value of a dotted key, whose parts are names or places in a list."""
    node: Any = plain
    for part in key.split("."):
        if isinstance(node, list) and part.isdecimal() and int(part) < len(node):
            node = node[int(part)]
        elif isinstance(node, Mapping) and part in node:
            node = node[part]
        else:
            return MISSING
    return node


def change(plain: dict[str, Any], key: str, value: object, *, replace: bool = False) -> None:
    """Set the value of a dotted key; sections on the path to it that are missing are added.

    A mapping is merged into the one that is there. ``replace``: unless it has a name, by which it
    replaces the settings of the plugin that is there.

    Raises:
        ConfigError: a part of the key is a value, which has no settings.
    """
    parents, _, leaf = key.rpartition(".")
    node: Any = plain
    for parent in parents.split(".") if parents else ():
        if isinstance(node, dict) and node.get(parent) is None:
            node[parent] = {}
        node = find(node, parent)
        if not isinstance(node, dict | list):
            raise ConfigError(f"{key}: {parent} is a value, not a section; it is {node!r}")
    if isinstance(node, dict):
        _merge(node, leaf, value, replace=replace)
    elif find({"": node}, f".{leaf}") is MISSING:
        raise ConfigError(f"{key}: there is no item {leaf} in a list of {len(node)}")
    else:
        node[int(leaf)] = _copy(value)


def drop(plain: dict[str, Any], key: str) -> None:
    """Drop a dotted key that exists."""
    parents, _, leaf = key.rpartition(".")
    del (find(plain, parents) if parents else plain)[leaf]


def _merge(node: dict[str, Any], key: str, value: object, *, replace: bool) -> None:
    old = node.get(key)
    named = replace and isinstance(value, Mapping) and "name" in value
    if isinstance(old, dict) and isinstance(value, Mapping) and not named:
        for inner, item in value.items():
            _merge(old, inner, item, replace=replace)
    elif isinstance(old, dict) and "name" in old and isinstance(value, str):
        node[key] = {"name": value}  # other keys may set its fields
    else:
        node[key] = _copy(value)


def _copy(value: object) -> Any:
    """Return a copy of mappings and lists, since later changes may lie inside them."""
    if isinstance(value, Mapping):
        return {name: _copy(inner) for name, inner in value.items()}
    return [_copy(inner) for inner in value] if isinstance(value, list) else value


def with_overrides(config: SettingsT, overrides: Mapping[str, Any]) -> SettingsT:
    """Return ``config`` with overrides applied; their keys may be nested or dotted.

    What is chosen by its name, such as an engine or a robot, comes first, whatever the order, as
    groups do on the command line. A collector that is named again keeps its settings.

    A reward term set to None is dropped; an empty mapping of rewards drops all terms.
    """
    plain = to_dict(config)
    for key, value in sorted(overrides.items(), key=lambda item: not _is_named(*item)):
        if key == "rewards" and value == {}:  # it replaces the terms instead of merging into them
            plain[key] = {}
        elif key == "logger" and not isinstance(value, Mapping):  # names replace all loggers
            plain[key] = loggers_by_name(value)
        elif key == "collector" and isinstance(value, str):
            if find(plain, "collector.name") != value:
                plain[key] = {"name": value}
        elif key == "robot" and isinstance(value, str):
            change(plain, key, to_dict(named_robot(value)))
        else:
            change(plain, key, value, replace=True)
    if isinstance(rewards := plain.get("rewards"), dict):
        plain["rewards"] = {name: term for name, term in rewards.items() if term is not None}
    # Other sections stay as they are: one may stand for a plugin that is missing.
    changed = {key.partition(".")[0] for key in overrides}
    return parse(type(config), plain | {k: v for k, v in config if k not in changed})


def _is_named(key: str, value: object) -> bool:
    """Return whether an override replaces a section by another one of a name."""
    named = isinstance(value, (str, Plugin)) or (isinstance(value, Mapping) and "name" in value)
    return "." not in key and (named or key in ("collector", "logger"))
