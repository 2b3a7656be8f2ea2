"""The reader of all YAML files of the user's, which converts nothing that could be meant otherwise.

In: a file or its text. Out: plain data. PyYAML alone reads YAML 1.1, in which ``035`` is 29,
``yes`` is true and ``12:30`` is 750, and takes the last of two values of a key. Here, numbers are
decimal as on the command line, ``true``, ``false`` and ``null`` are the only words, anything else
is text, and a key is the text that was written, so that ``010`` and ``8`` are two keys.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib.resources.abc import Traversable
from typing import Any, ClassVar

import yaml

from flipperctl.errors import ConfigError

_TAG = "tag:yaml.org,2002:"
_SCALARS: dict[str, tuple[str, Callable[[str], object]]] = {
    "null": ("~|null|Null|NULL|", lambda text: None),
    "bool": ("true|True|TRUE|false|False|FALSE", lambda text: text.lower() == "true"),
    "int": ("[-+]?(0|[1-9][0-9]*)", int),
    "float": (
        r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+|0|[1-9][0-9]*)([eE][-+]?[0-9]+)?"
        r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        lambda text: float(re.sub(r"\.(?=[in])", "", text.lower())),
    ),
}
"""Tag → what has it without quotes, and the value."""


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
    try:
        return yaml.load(text, _Loader)  # noqa: S506  # a SafeLoader
    except RecursionError as error:
        raise ConfigError(f"{where}: it is nested too deeply") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        problem = " ".join(str(getattr(error, "problem", None) or error).split())
        kind = "" if isinstance(error, _RefusedError) else "no YAML: "
        raise ConfigError(f"{where}{line}: {kind}{problem}") from error


class _RefusedError(yaml.MarkedYAMLError):  # type: ignore[misc]  # PyYAML has no types
    """A key or value of a valid text is refused."""

    def __init__(self, text: str, node: yaml.Node) -> None:
        super().__init__(problem=text, problem_mark=node.start_mark)


class _Loader(yaml.SafeLoader):  # type: ignore[misc]  # as above
    yaml_implicit_resolvers: ClassVar[dict[str | None, list[Any]]] = {}
    yaml_constructors: ClassVar[dict[str | None, Any]] = {}

    def compose_mapping_node(self, anchor: Any) -> Any:
        """Check the keys before those of a ``<<`` are merged, which they may override."""
        node = super().compose_mapping_node(anchor)
        given: dict[str, int] = {}
        for key, _ in node.value:
            line = key.start_mark.line + 1
            if not (isinstance(key, yaml.ScalarNode) and key.value):
                raise _RefusedError("a key is a text", key)
            if first := given.setdefault(key.value, 0):
                raise _RefusedError(
                    f"{key.value} is given twice, also in line {first}; one is allowed", key
                )
            given[key.value] = line
        return node


def _mapping(loader: _Loader, node: yaml.MappingNode) -> dict[str, Any]:
    if isinstance(node, yaml.MappingNode):
        loader.flatten_mapping(node)
        return {k.value: loader.construct_object(v, deep=True) for k, v in node.value}
    raise _RefusedError("a mapping is expected here", node)


def _scalar(tag: str) -> Callable[[_Loader, yaml.Node], object]:
    pattern, convert = _SCALARS[tag]

    def construct(loader: _Loader, node: yaml.Node) -> object:
        text = str(loader.construct_scalar(node))
        if not re.fullmatch(pattern, text):
            raise _RefusedError(f"{text!r} is not of the type !!{tag}", node)
        try:
            return convert(text)
        except ValueError as error:  # of an integer of thousands of digits
            raise _RefusedError(f"{text[:20]}… cannot be read: {error}", node) from error

    return construct


for _tag, (_pattern, _) in _SCALARS.items():
    _Loader.add_implicit_resolver(_TAG + _tag, re.compile(rf"(?:{_pattern})\Z"), None)
    _Loader.add_constructor(_TAG + _tag, _scalar(_tag))
_Loader.add_implicit_resolver(f"{_TAG}merge", re.compile(r"<<\Z"), ["<"])
_Loader.add_constructor(f"{_TAG}str", yaml.SafeLoader.construct_yaml_str)
_Loader.add_constructor(f"{_TAG}map", _mapping)
_Loader.add_constructor(f"{_TAG}seq", lambda loader, node: loader.construct_sequence(node, True))
_Loader.add_constructor(None, yaml.SafeLoader.construct_undefined)
