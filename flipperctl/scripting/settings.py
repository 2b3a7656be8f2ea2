"""Keyword arguments as the overrides that the commands take.

In: Python values by configuration key. Out: words in Hydra's grammar, ``key=value``.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum

import numpy as np

from flipperctl.api import Settings
from flipperctl.config import to_dict
from flipperctl.config.defaults import CHOICES, LISTS
from flipperctl.config.words import quoted
from flipperctl.errors import ConfigError

_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_RESERVED = {"null", "true", "false", "nan", "inf"}
"""Words that Hydra does not read as text, in any case."""
_REWARDS = "controller.rewards"
"""End of the keys of settings whose value is a mapping of reward terms."""


def words(settings: Mapping[str, object], overrides: Sequence[str] = ()) -> list[str]:
    """Return the overrides of the settings, and behind them those that are written already.

    Keys may be dotted. A mapping sets the fields below its key; the ``name`` in it, or a plugin's
    settings as an object, choose a plugin as well. Several names of a choice are several scenes. A
    reward term that is None is dropped, and an empty mapping of rewards drops all terms. The
    rewards of a controller are one setting: a preset's name, or all terms.

    Raises:
        ConfigError: a value cannot be a setting.
    """
    if isinstance(overrides, str):
        raise ConfigError(f"overrides: a list of words is allowed; the value is {overrides!r}")
    found = [word for key, value in settings.items() for word in _words(key, _plain(value))]
    return [*found, *overrides]


def _words(key: str, value: object) -> Iterator[str]:
    if (key == "rewards" and value == {}) or (_is_term(key) and value is None):
        yield f"~{key}"
    elif isinstance(value, Mapping) and value and not key.endswith(_REWARDS):
        fields = {str(name): _plain(inner) for name, inner in value.items()}
        if key in CHOICES and "name" in fields:
            yield f"{key}={literal(fields.pop('name'), key)}"
        for name, inner in fields.items():
            yield from _words(f"{key}.{name}", inner)
    elif key in CHOICES and key not in LISTS and isinstance(value, list) and value:
        if not all(isinstance(name, str) for name in value):
            raise ConfigError(f"{key}: names are allowed in a list; the value is {value!r}")
        yield f"{key}={','.join(literal(name, key) for name in value)}"
    else:
        yield f"{key}={literal(value, key)}"


def _is_term(key: str) -> bool:
    section, _, name = key.partition(".")
    return section == "rewards" and bool(name) and "." not in name


def literal(value: object, key: str) -> str:
    """Return a value in Hydra's grammar, where a text stands for itself.

    ``key`` is that of the setting, for the error.

    Raises:
        ConfigError: the value has no form in the grammar.
    """
    value = _plain(value)
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        bare = _NAME.fullmatch(value) and value.lower() not in _RESERVED
        return value if bare else quoted(value)
    if isinstance(value, list):
        return f"[{','.join(literal(item, key) for item in value)}]"
    if isinstance(value, Mapping):
        return f"{{{','.join(_entry(name, item, key) for name, item in value.items())}}}"
    raise ConfigError(
        f"{key}: {value!r} is no setting; numbers, texts, paths, None, lists, mappings and "
        "settings of plugins are allowed"
    )


def _entry(name: object, value: object, key: str) -> str:
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        raise ConfigError(f"{key}: {name!r} is no name of a field in a list; letters and _ are")
    return f"{name}:{literal(value, key)}"


def _plain(value: object) -> object:
    """Return the value without the types of numpy, paths, tuples, enumerations and settings."""
    if isinstance(value, Settings):
        return to_dict(value, brief=True)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Enum):
        return _plain(value.value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, range | tuple):
        return list(value)
    return value
