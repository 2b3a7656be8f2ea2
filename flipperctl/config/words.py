"""Overrides as words, ``key=value``, before they are parsed: mistakes in typing, and further ones.

In: the words that a user typed, and the values of options. Out: words, or the error that explains
what the parser would not.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from flipperctl.errors import ConfigError, RequestError

_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_RESERVED = {"null", "true", "false", "nan", "inf"}
"""Words that Hydra does not read as text, in any case."""


def key_of(word: str) -> str:
    """Return the key of an override as it was typed."""
    return word.lstrip("+~").partition("=")[0]


def check_different(where: str, values: Sequence[object]) -> None:
    """Refuse a list that names something twice."""
    for index, value in enumerate(values):
        if value in values[:index]:
            raise ConfigError(f"{where}: {value} is given twice; once is allowed")


def check_words(overrides: Sequence[str]) -> None:
    """Refuse a word that is no override, and a key with two, of which Hydra takes the last."""
    for word in overrides:
        key, equals, _ = word.lstrip("+~").partition("=")
        if (equals and not key.strip()) or not (equals or word.startswith("~")):
            raise ConfigError(
                f"{word!r} is no override; write key=value without spaces around the =, and "
                "quotes around a value with spaces"
            )
    first_words: dict[str, str] = {}
    for word in overrides:
        if (key := key_of(word)) in first_words:
            raise ConfigError(
                f"{key} is given twice: {first_words[key]} and {word}; one is allowed"
            )
        first_words[key] = word


def unreadable(word: str) -> ConfigError:
    """Return the error for an override that Hydra cannot parse."""
    key, _, value = word.partition("=")
    return ConfigError(
        f"{word!r}: Hydra cannot read this override; if its value is meant as it stands, quote "
        f"it: {quote_override(key, value)}"
    )


def literal_override(key: str, value: str) -> str:
    """Return an override whose value Hydra takes literally."""
    return f"{key}={quoted(value)}"


def quoted(text: str) -> str:
    """Return a text in double quotes, as Hydra takes it literally.

    Backslashes before a quote or a ``${`` are doubled, also before the last one.
    """
    inside = re.sub(r'(\\+)(?="|\Z)', r"\1\1", escaped(text)).replace('"', r"\"")
    return f'"{inside}"'


def escaped(value: Any) -> Any:
    """Return plain data in whose texts OmegaConf looks up no ``${…}``."""
    if isinstance(value, str):
        return re.sub(r"(\\*)\$\{", r"\1\1\\${", value)
    if isinstance(value, Mapping):
        return {name: escaped(inner) for name, inner in value.items()}
    return [escaped(inner) for inner in value] if isinstance(value, list) else value


def literal(value: object) -> str:
    """Return plain data as Hydra reads it, with all digits; a text stands for itself."""
    if isinstance(value, str):
        bare = _NAME.fullmatch(value) and value.lower() not in _RESERVED
        return value if bare else quoted(value)
    if isinstance(value, list):
        return f"[{','.join(map(literal, value))}]"
    if isinstance(value, Mapping):
        return f"{{{','.join(f'{key}:{literal(inner)}' for key, inner in value.items())}}}"
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else repr(value)


def quote_override(key: str, value: str) -> str:
    """Return an override whose value Hydra takes literally, quoted for the shell as well."""
    return shlex.quote(literal_override(key, value))


def override_text(value: object) -> str:
    """Return a value as it is typed in an override; of a plugin, its name."""
    if isinstance(value, list | tuple):
        return f"[{','.join(map(override_text, value))}]"
    if isinstance(value, Mapping):
        inner = ",".join(f"{key}: {override_text(item)}" for key, item in value.items())
        return str(value["name"]) if "name" in value else f"{{{inner}}}"
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def with_flags(
    overrides: Sequence[str] | None, section: str = "eval", **flags: str | None
) -> list[str]:
    """Return the overrides, and those of ``section`` that the given flags stand for."""
    words = list(overrides or [])
    keys = {key_of(override): override for override in words}
    for name, value in flags.items():
        key = f"{section}.{name}"
        if value is None:
            continue
        if key in keys:
            raise RequestError(
                f"{key} is given twice: --{name} {value} and {keys[key]}; one is allowed"
            )
        words.append(f"{key}={value}")
    return words


def with_default(overrides: list[str], key: str, value: object) -> list[str]:
    """Return the overrides, and ``key=value`` if none of them sets the key."""
    return overrides if key in map(key_of, overrides) else [*overrides, f"{key}={value}"]


def with_engine(overrides: list[str]) -> list[str]:
    """Return the overrides with ``sim=mujoco``, unless they choose an engine."""
    has_engine = any(override.lstrip("+").startswith("sim=") for override in overrides)
    return list(overrides) if has_engine else ["sim=mujoco", *overrides]
