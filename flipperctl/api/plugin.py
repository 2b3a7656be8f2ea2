"""The base class of all plugins, the registry of their names, and selection by name."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FunctionType
from typing import Any, ClassVar, NamedTuple, TypeVar

from flipperctl.api.values import Settings


class Plugin(Settings):
    """Base class of all plugin families; a plugin's fields are its settings."""

    kind: ClassVar[str]
    plugin_name: ClassVar[str]
    revision: ClassVar[str] = ""
    """What tells two plugins apart whose name, settings and files are equal; empty for none."""

    def files_read(self) -> tuple[Path, ...]:
        """Return files whose content affects the plugin's results, beside the ``Path`` settings.

        The keys of stored episodes, seeds and resumed runs cover the content of both.
        """
        return ()

    def notices(self) -> tuple[str, ...]:
        """Return sentences about input that may not be what the user meant; none by default.

        Each command that uses the plugin prints them once, on stderr.

        Raises:
            ValueError: the files cannot be read; using the plugin raises a more detailed error.
        """
        return ()


registry: dict[tuple[str, str], type[Plugin]] = {}
"""(kind, name) → class, filled by the decorators when a plugin's module is imported."""


class Broken(NamedTuple):
    """An entry point of an installed package that does not load."""

    name: str
    package: str
    module: str
    names: frozenset[str]
    """Its own name, and the names of plugins that it registered before it failed."""
    reason: str
    """A sentence with package, file, line and error."""


broken: list[Broken] = []
"""What ``plugins.load`` left out."""


PluginT = TypeVar("PluginT", bound=Plugin)

NAME_RULE = "lower-case letters, digits and _ are allowed, a letter first, and no word of YAML"
"""The rule for names of plugins, in words for an error."""


_YAML = {"null", "true", "false", "yes", "no", "on", "off", "nan", "inf"}
"""What a configuration or an override reads as a value."""
_DECORATORS = {"sim": "engine", "perception": "sensor", "agent": "learner"}
"""Kind → name of its decorator, where they differ."""


_COMMAND = r"[a-z][a-z0-9-]*( [a-z][a-z0-9-]*)?"
"""A subcommand's name is no value of a configuration, but one word or two that are typed."""


def is_plugin_name(name: str, kind: str = "") -> bool:
    """Return whether the name is valid for a plugin of a kind; see ``NAME_RULE``."""
    if kind == "command":
        return re.fullmatch(_COMMAND, name) is not None
    return re.fullmatch(r"[a-z][a-z0-9_]*", name) is not None and name not in _YAML


def register(
    family: type[Any], name: str, check: Callable[[Any, str], None] | None = None
) -> Callable[[type[PluginT]], type[PluginT]]:
    """Return a decorator that registers a class of ``family`` under ``name``.

    ``check`` refuses a class, given with the words with which its errors begin.

    Raises:
        ValueError: the name is not valid or is already taken in the family.
        TypeError: the decorated class is not a subclass of ``family`` or is refused, or there is no
            name.
    """
    decorator = _DECORATORS.get(family.kind, family.kind)
    if isinstance(name, type | FunctionType):  # what is decorated itself
        example = name.__name__.lower()
        raise TypeError(
            f'@{decorator} needs a name in parentheses: write @{decorator}("{example}")'
        )
    if not is_plugin_name(name, family.kind):
        words = "one word or two of lower-case letters, digits and - are allowed"
        rule = words if family.kind == "command" else NAME_RULE
        raise ValueError(f"plugin name {name!r}: {rule}")

    where = f"@{decorator}({name!r})"

    def decorate(cls: type[PluginT]) -> type[PluginT]:
        if not issubclass(cls, family):
            raise TypeError(f"{where}: {cls.__name__} is not a {family.__name__}")
        if "name" in cls.model_fields:
            raise TypeError(f"{where}: a setting cannot be called name, which selects the plugin")
        # A setting is written by its field's name, in files and on command lines alike.
        for field, info in cls.model_fields.items():
            if info.alias or info.validation_alias or info.serialization_alias:
                raise TypeError(
                    f"{where}: {field} has an alias; a setting is written by the name of its field "
                    "everywhere, so leave the alias out, or rename the field"
                )
        # A field would hide a method or property of the family from the core.
        for field in cls.model_fields.keys() - family.model_fields.keys():
            if hasattr(family, field):
                raise TypeError(
                    f"{where}: {field} is a part of {family.__name__}, not a setting; annotate it "
                    "as ClassVar, or call the setting something else"
                )
        if check is not None:
            check(cls, where)
        # A cell of a notebook that is run again defines the same class anew.
        taken = registry.get((family.kind, name))
        if taken is not None and _place(taken) != _place(cls):
            raise ValueError(
                f"two {family.kind} plugins are called {name!r}: "
                f"{taken.__module__}.{taken.__qualname__} and {cls.__module__}.{cls.__qualname__}; "
                "choose another name, or keep one: uninstall the package, or leave out its file"
            )
        cls.plugin_name = name
        registry[family.kind, name] = cls
        return cls

    return decorate


def _place(cls: type[Plugin]) -> tuple[str, str]:
    return cls.__module__, cls.__qualname__


def registered_names(kind: str) -> list[str]:
    """Return the registered names of one family, sorted."""
    return sorted(name for family, name in registry if family == kind)


def selected(kind: str, value: object) -> tuple[type[Plugin], dict[str, Any]]:
    """Return the class and the fields that a name, or a mapping with ``name``, selects.

    Raises:
        TypeError: ``value`` is neither.
        LookupError: no plugin of this family has the name.
    """
    if isinstance(value, str):
        value = {"name": value}
    if not isinstance(value, Mapping) or "name" not in value:
        raise TypeError("a name, or a mapping with 'name' and fields, is allowed")
    cls = registry.get((kind, str(value["name"])))
    if cls is None:
        raise LookupError(f"there is no {kind} plugin {value['name']!r}")
    return cls, {key: field for key, field in value.items() if key != "name"}


def mapping(plugin: Plugin, *, brief: bool) -> dict[str, Any]:
    """Return the plain mapping with ``name`` and fields that selects an equal plugin.

    ``brief``: a nested plugin whose settings are all defaults is written as its name alone.
    """
    fields = plugin.model_dump(mode="json", context={"brief": brief})
    return {"name": plugin.plugin_name, **fields}
