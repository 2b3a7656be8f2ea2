"""The reader of the package's own YAML files: YAML 1.2, in which a key is a text with one value.

In: a file or its text. Out: plain data. YAML 1.1, as which other readers take files, turns ``035``
into 29, ``yes`` into true and ``12:30`` into 750, and lets the last of two values of a key stand.
"""

from __future__ import annotations

from importlib.resources.abc import Traversable
from typing import Any

from flipperctl.errors import ConfigError


def read(file: Traversable, where: str) -> Any:
    """Return the data of a file, which errors call ``where``."""
    return parse(read_text(file, where), where)


def read_text(file: Traversable, where: str) -> str:
    """Return the text of a file, which errors call ``where``."""
    try:
        return file.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{where} is not text in UTF-8") from error
    except (OSError, ValueError) as error:  # ValueError: of a path with a null character
        raise ConfigError(
            f"{where} cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from error


def parse(text: str, where: str) -> Any:
    """Return the data of a text in YAML, which errors call ``where``."""
    from ruamel.yaml import YAML
    from ruamel.yaml.constructor import DuplicateKeyError
    from ruamel.yaml.error import YAMLError

    try:
        data = YAML(typ="safe", pure=True).load(text)
        _check_keys(data, where)
    except RecursionError as error:
        raise ConfigError(f"{where}: it is nested too deeply") from error
    except (YAMLError, ValueError) as error:  # ValueError: of an integer of thousands of digits
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        problem = " ".join(str(getattr(error, "problem", None) or error).split())
        kind = "" if isinstance(error, DuplicateKeyError) else "no YAML: "
        raise ConfigError(f"{where}{line}: {kind}{problem:.200}") from error
    return data


def _check_keys(data: object, where: str) -> None:
    """Refuse keys that are no texts, such as numbers, which nothing here has."""
    for key in data if isinstance(data, dict) else ():
        if not isinstance(key, str):
            raise ConfigError(f"{where}: a key is a text; write {str(key)!r} in quotes, not {key}")
    values = data.values() if isinstance(data, dict) else data if isinstance(data, list) else ()
    for value in values:
        _check_keys(value, where)
