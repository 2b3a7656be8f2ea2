"""Parse and quote overrides, and explain mistakes for which Hydra has no clear message."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Sequence
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override

from flipperctl.errors import ConfigError

_FOLDERS = ("hydra.run.dir", "hydra.sweep.dir")


def parse_overrides(overrides: Iterable[str]) -> list[Override]:
    """Return the overrides as Hydra parses them.

    Raises:
        OverrideParseException: Hydra cannot read one of them.
    """
    found: list[Override] = OverridesParser.create().parse_overrides(list(overrides))
    return found


def override_values(overrides: Iterable[str]) -> dict[str, Any]:
    """Return the value of each key, for overrides that are applied without composition.

    Raises:
        OverrideParseException: Hydra cannot read one of the overrides.
        ConfigError: an override is not a plain ``key=value``, such as a list of values, or a key
            is given twice.
    """
    overrides = list(overrides)
    check_once(overrides)
    found = {}
    for override in parse_overrides(overrides):
        plain = not (override.is_delete() or override.is_add() or override.is_force_add())
        if not plain or override.is_sweep_override():
            raise ConfigError(f"{override.input_line}: one value is allowed here, as in key=value")
        found[override.key_or_group] = override.value()
    return found


def check_once(overrides: Iterable[str]) -> None:
    """Refuse a key with two values, of which Hydra would take the last.

    Raises:
        ConfigError: a key is given twice.
    """
    given: dict[str, str] = {}
    for override in overrides:
        key = override.lstrip("+~").partition("=")[0]
        if key in given:
            raise ConfigError(f"{key} is given twice: {given[key]} and {override}; one is allowed")
        given[key] = override


def check_folders(overrides: Iterable[str]) -> None:
    """Refuse an empty folder name, which would mix runs with the user's own files.

    Raises:
        OverrideParseException: Hydra cannot read one of the overrides.
        ConfigError: ``hydra.run.dir=`` or ``hydra.sweep.dir=`` without a value.
    """
    for override in parse_overrides(overrides):
        key = override.get_key_element()
        if key in _FOLDERS and override.value() in ("", None):
            raise ConfigError(
                f"{key}: the name of a folder is allowed, . for the one you are in; "
                f"the value is {override.value()!r}"
            )


def check_mappings(overrides: Iterable[str]) -> None:
    """Refuse an empty mapping, since Hydra merges it and nothing would change.

    Raises:
        OverrideParseException: Hydra cannot read one of the overrides.
        ConfigError: a value is an empty mapping; the text has the override that drops the key.
    """
    for override in parse_overrides(overrides):
        if not override.is_delete() and override.value() == {}:
            key = override.get_key_element()
            drop = "~rewards drops every term" if key == "rewards" else f"~{key} drops it"
            raise ConfigError(
                f"{override.input_line}: a mapping is merged into what is there, and an empty one "
                f"changes nothing; {drop}"
            )


def check_words(overrides: Sequence[str]) -> None:
    """Refuse a word that is not an override, because of the shell or a typing mistake.

    Raises:
        ConfigError: a word has no key, or no ``=``, for instance after a space in a value; or a
            key is given twice.
    """
    before = ""
    for word in overrides:
        key, equals, _ = word.lstrip("+~").partition("=")
        if equals and not key.strip():
            raise ConfigError(f"{word!r} has no key; write key=value, as in terrain=stair")
        if not equals and not word.startswith("~"):
            hint = ""
            if before:
                key, _, value = before.partition("=")
                hint = (
                    f"; if it belongs to {before!r}, write {quote_override(key, f'{value} {word}')}"
                )
            raise ConfigError(
                f"{word!r} is no override; write key=value, as in terrain=stair{hint}"
            )
        before = word
    check_once(overrides)


def literal_override(key: str, value: str) -> str:
    """Return an override whose value Hydra takes literally."""
    escaped = re.sub(r'(\\*)"', r'\1\1\\"', value)
    return f'{key}="{escaped}"'


def quote_override(key: str, value: str) -> str:
    """Return an override whose value Hydra takes literally, quoted for the shell as well."""
    return shlex.quote(literal_override(key, value))
