"""Overrides as the user typed them: slips that Hydra has no clear words for, and how to quote."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Sequence

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override

from flipperctl.errors import ConfigError

_FOLDERS = ("hydra.run.dir", "hydra.sweep.dir")


def check_folders(overrides: Iterable[str]) -> None:
    """Refuse an empty name for a folder: runs would lie between the user's own files.

    Raises:
        OverrideParseException: Hydra cannot read one of the overrides.
        ConfigError: ``hydra.run.dir=`` or ``hydra.sweep.dir=`` without a value.
    """
    parsed: list[Override] = OverridesParser.create().parse_overrides(list(overrides))
    for override in parsed:
        key = override.get_key_element()
        if key in _FOLDERS and override.value() in ("", None):
            raise ConfigError(
                f"{key}: the name of a folder is allowed, . for the one you are in; "
                f"the value is {override.value()!r}"
            )


def check_words(overrides: Sequence[str]) -> None:
    """Refuse what is no override because of the shell or a slip of the hand.

    Raises:
        ConfigError: there is no key, or no ``=``, as after a space in a value.
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
                hint = f"; if it belongs to {before!r}, write {quoted(key, f'{value} {word}')}"
            raise ConfigError(
                f"{word!r} is no override; write key=value, as in terrain=stair{hint}"
            )
        before = word


def quoted(key: str, value: str) -> str:
    """An override whose value Hydra takes as it is, quoted for the shell too."""
    escaped = re.sub(r'(\\*)"', r'\1\1\\"', value)
    return shlex.quote(f'{key}="{escaped}"')


def wrong_choice(error: Exception, overrides: Sequence[str], groups: Sequence[str]) -> ConfigError:
    """The error for what Hydra says of a group whose choice is no name, as in ``terrain=3``."""
    for override in OverridesParser.create().parse_overrides(list(overrides)):
        key, value = override.get_key_element(), override.value()
        names = value if isinstance(value, list) else [value]
        optional = key == "experiment" and value is None
        if key in (*groups, "experiment") and not optional and not _all_names(names):
            return ConfigError(f"{key}: a name is allowed; the value is {value!r}")
    return ConfigError(" ".join(str(error).split()))


def _all_names(values: Iterable[object]) -> bool:
    return all(isinstance(value, str) for value in values)
