"""Words as requests, by Hydra's grammar of overrides.

In: ``key=value``, as typed on a command line, in a suite, or given to Python as ``overrides``. Out:
requests, whose values are plain data.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Glob, Override
from hydra.errors import OverrideParseException

from flipperctl.config import policy_file
from flipperctl.config.resolver import is_robot_file
from flipperctl.config.words import check_words, key_of, unreadable
from flipperctl.errors import ConfigError
from flipperctl.requests.compose import group_names
from flipperctl.requests.request import CONTROLLERS, Request, Requests, Several
from flipperctl.text.files import at_home
from flipperctl.training.search import Interval


def from_words(words: Iterable[str]) -> Requests:
    """Return the requests of the words.

    Raises:
        ConfigError: a word is no override, Hydra cannot read it, or a key is given twice.
    """
    typed = list(map(at_home, words))
    check_words(typed)
    return Requests.of(read(typed))


def read(words: Iterable[str]) -> Iterator[Request]:
    """Yield the request of each word, without a check of the words together."""
    words = list(words)
    # Names of files need no quotes; Hydra reads all other words.
    files = {word: request for word in words if (request := _of_file(word)) is not None}
    others = [word for word in words if word not in files]
    try:
        overrides = iter(OverridesParser.create().parse_overrides(others))
    except OverrideParseException as error:
        raise unreadable(str(error.override)) from error
    except ValueError as error:  # Python reads integers of up to 4300 digits
        key = key_of(max(words, key=len))
        raise ConfigError(f"{key}: its number has too many digits") from error
    for word in words:
        yield files[word] if word in files else _request(next(overrides))


def _of_file(word: str) -> Request | None:
    """Return the request of a word whose value is the name of a file, which needs no quotes."""
    key, _, value = word.partition("=")
    name = value.strip().strip("'\"")
    controller = key in CONTROLLERS and policy_file.is_policy_file(name)
    if key == "suite" or controller or (key == "robot" and is_robot_file(name)):
        return Request(key, name, typed=word)
    return None


def _request(override: Override) -> Request:
    typed, name = str(override.input_line), override.get_key_element()
    value: Any = override.value()
    if override.is_interval_sweep():
        value = Interval(value.start, value.end, "log" in value.tags, typed)
    elif isinstance(value, Glob):
        entries = value.filter(group_names(override.key_or_group))
        value = Several(tuple(read(f"{name}={entry}" for entry in entries)))
        if not entries:
            raise ConfigError(
                f"{typed}: no name fits; glob(…) chooses among the names of a group, as in "
                "terrain=glob(st*)"
            )
    elif override.is_sweep_override():
        value = Several(tuple(read(f"{name}={v}" for v in override.sweep_string_iterator())))
    prefix = name[: len(name) - len(name.lstrip("+~"))]
    return Request(override.key_or_group, value, prefix, override.package, typed)
