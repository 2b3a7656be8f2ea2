"""Overrides as words, ``key=value``, before they are parsed: mistakes in typing, and further ones.

In: the words that a user typed, and the values of options. Out: words, or the error that explains
what the parser would not.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path

from flipperctl.api.plugin import registered_names
from flipperctl.config import policy_file
from flipperctl.config.presets import presets
from flipperctl.config.resolver import is_robot_file, named_robot
from flipperctl.errors import ConfigError, RequestError


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
    before = ""
    for word, after in zip_longest(overrides, overrides[1:], fillvalue=""):
        key, equals, _ = word.lstrip("+~").partition("=")
        if not equals and after.startswith("="):
            raise ConfigError(f"{word} {after}: write key=value without spaces around the =")
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
    given: dict[str, str] = {}
    for word in overrides:
        if (key := key_of(word)) in given:
            raise ConfigError(f"{key} is given twice: {given[key]} and {word}; one is allowed")
        given[key] = word


def unreadable(word: str) -> ConfigError:
    """Return the error for an override that Hydra cannot parse."""
    key, _, value = word.partition("=")
    if re.search(r"\s[+~]*[\w./@]+=", value):
        return ConfigError(
            f"{word!r}: if this word holds several overrides, leave the quotes around them out: "
            f"{word}; if it is one value, quote it: {quote_override(key, value)}"
        )
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
    text = re.sub(r"(\\*)\$\{", r"\1\1\\${", text)  # OmegaConf would look up what follows
    escaped = re.sub(r'(\\+)(?="|\Z)', r"\1\1", text).replace('"', r"\"")
    return f'"{escaped}"'


def quote_override(key: str, value: str) -> str:
    """Return an override whose value Hydra takes literally, quoted for the shell as well."""
    return shlex.quote(literal_override(key, value))


def override_text(value: object) -> str:
    """Return a value as it is typed in an override; of a plugin, its name."""
    if isinstance(value, list | tuple):
        return f"[{','.join(map(override_text, value))}]"
    if isinstance(value, Mapping):
        inner = ",".join(f"{key}: {override_text(one)}" for key, one in value.items())
        return str(value["name"]) if "name" in value else f"{{{inner}}}"
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def with_flags(
    overrides: Sequence[str] | None, section: str = "eval", **flags: str | None
) -> list[str]:
    """Return the overrides, and those of ``section`` that the given flags stand for."""
    found = list(overrides or [])
    keys = {key_of(override): override for override in found}
    for name, value in flags.items():
        key = f"{section}.{name}"
        if value is None:
            continue
        if key in keys:
            raise RequestError(
                f"{key} is given twice: --{name} {value} and {keys[key]}; one is allowed"
            )
        found.append(f"{key}={value}")
    return found


def with_default(overrides: list[str], key: str, value: object) -> list[str]:
    """Return the overrides, and ``key=value`` if none of them sets the key."""
    return overrides if key in map(key_of, overrides) else [*overrides, f"{key}={value}"]


def with_engine(overrides: list[str]) -> list[str]:
    """Return the overrides with ``sim=mujoco``, unless they choose an engine."""
    chosen = any(override.lstrip("+").startswith("sim=") for override in overrides)
    return list(overrides) if chosen else ["sim=mujoco", *overrides]


def expand_files(words: Sequence[str]) -> list[str]:
    """Return overrides in Hydra's spelling, of ``rewards.calm=calm`` and of files.

    A reward term that no preset has is added. ``robot=FILE`` is replaced by all settings of the
    file, in place of those of a policy's training too, and so are ``controller=FILE`` and
    ``teacher=FILE``. One that another word sets is left to that word.
    """
    given = set(map(key_of, words))
    return [found for word in words for found in _expand(word, given)]


def _terms() -> frozenset[str]:
    """Return the reward terms of presets, which a word replaces, and never adds."""
    texts = (file.read_text("utf-8") for file in presets("rewards").values())
    return frozenset(name for text in texts for name in re.findall(r"- /reward@(\w+):", text))


_CONTROLLERS = {"controller": "controller", "teacher": "teacher.controller"}
"""Key that names a controller → section of its settings."""


def _literal(value: object) -> str:
    """Return plain data as Hydra reads it, with all digits."""
    if isinstance(value, str):
        return quoted(value)
    if isinstance(value, list):
        return f"[{','.join(map(_literal, value))}]"
    if isinstance(value, dict):
        return f"{{{','.join(f'{key}: {_literal(one)}' for key, one in value.items())}}}"
    return json.dumps(value)


def _expand(word: str, given: Collection[str]) -> Iterator[str]:
    key, _, value = word.partition("=")
    name = value.strip().strip("'\"")
    term = key.removeprefix("rewards.")
    if key == f"rewards.{term}" and name in registered_names("reward") and term not in _terms():
        yield f"+reward@{key}={name}"
        return
    if key in _CONTROLLERS and policy_file.is_policy_file(name):
        own = policy_file.settings_of(name, key)
        yield f"{key}={own.pop('name')}"
        for field, setting in own.items():
            if (path := f"{_CONTROLLERS[key]}.{field}") not in given:
                yield f"{path}={_literal(setting)}"
        return
    if key != "robot" or not is_robot_file(name):
        yield word
        return
    if "," in name and not Path(name).exists():
        raise ConfigError(
            f"{word}: one file is allowed; lists name robots of the package: "
            f"{', '.join(presets('robot'))}"
        )
    for field, setting in named_robot(name).model_dump(mode="json").items():
        if f"robot.{field}" not in given:
            yield f"robot.{field}={'null' if setting is None else repr(setting)}"
