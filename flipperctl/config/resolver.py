"""Convert names and overrides to validated settings, and settings to plain data.

In: a plugin's or a robot's name, composed values, overrides. Out: frozen settings with plugin
instances inside, whose methods name plugin, method, file and line when they fail. Every composed
configuration (by Hydra, from a checkpoint, from keyword arguments, by ``--resume``) passes through
``parse``.
"""

from __future__ import annotations

import functools
import inspect
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar
from weakref import WeakSet

from pydantic import ValidationError
from pydantic_core import PydanticSerializationError

from flipperctl.api import Plugin, Robot, Settings, registry
from flipperctl.api.plugin import mapping, registered_names
from flipperctl.config import strict_yaml
from flipperctl.config.presets import presets
from flipperctl.errors import (
    ConfigError,
    FlipperctlError,
    PluginError,
    PluginFailedError,
    TerrainError,
)
from flipperctl.plugging import guard
from flipperctl.text.files import at_home
from flipperctl.text.messages import broken_hint, close_match, explain, missing_name

SettingsT = TypeVar("SettingsT", bound=Settings)

METRICS_ALONE = "csv"
"""Choice of loggers that adds nothing to ``metrics.csv``, which every run writes."""
_FILES = (".yaml", ".yml")


def loggers_by_name(value: object) -> object:
    """Return a mapping of settings for a name or a list of names; other values unchanged."""
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        return value
    return {name: {"name": name} for name in names if name != METRICS_ALONE}


def is_robot_file(name: str) -> bool:
    """Return whether a robot is named by a file instead of a preset."""
    return name.lower().endswith(_FILES)


def named_robot(name: str) -> Robot:
    """Return the robot of a preset or of a file; settings that a file leaves out are nubot's."""
    where, known = f"robot={name}", presets("robot")
    if is_robot_file(name):
        where = str(Path(name))
        found = strict_yaml.read(Path(name), where)
    elif name in known:
        found = strict_yaml.read(known[name], where)
    else:
        raise ConfigError(
            f"robot: there is no robot {name!r}{close_match(name, known) or broken_hint()}; "
            f"known: {', '.join(known)}; a file of your own ends in .yaml"
        )
    if not isinstance(found, dict):
        raise ConfigError(
            f"{where}: settings of the robot are allowed, as in chassis_length: 0.7; known: "
            f"{', '.join(Robot.model_fields)}"
        )
    return parse(Robot, found, where)


def get(kind: str, name: object, where: str) -> type[Plugin]:
    """Return the class registered under ``name``."""
    if cls := registry.get((kind, str(name))):
        return cls
    known = registered_names(kind)
    raise ConfigError(
        f"{where}: there is no {kind} plugin {name!r}{missing_name(kind, str(name), known)}; "
        f"registered: {', '.join(known) or 'none'}"
    )


def create(kind: str, settings: object, where: str) -> Any:
    """Return a plugin instance from its name, or from a mapping with ``name`` and its fields."""
    if isinstance(settings, Plugin):
        if not hasattr(type(settings), "plugin_name"):
            raise ConfigError(
                f"{where}: {type(settings).__name__} is not registered; "
                f"decorate it with @{kind}(<name>)"
            )
        return _guarded(settings)
    named = {"name": settings} if isinstance(settings, str) else settings
    if not isinstance(named, Mapping) or "name" not in named:
        raise ConfigError(
            f"{where}: a plugin's name, or a mapping with 'name' and its fields, "
            f"is allowed; got {settings!r}"
        )
    cls = get(kind, named["name"], where)
    fields = at_home({key: value for key, value in named.items() if key != "name"})
    try:
        return construct(cls, fields)
    except ValidationError as error:
        raise ConfigError(explain(error, where, cls, fields)) from error


def reference(name: str, where: str) -> dict[str, Any]:
    """Return name and fields of a controller that is named beside another policy."""
    return {"name": name, **getattr(get("controller", name, where), "reference_settings", {})}


def construct(cls: type[Plugin], fields: Mapping[str, Any]) -> Plugin:
    """Return an instance of a plugin, whose methods are guarded."""
    try:
        plugin = cls(**fields)
    except BaseException as error:
        own_title = cls.model_config.get("title") or cls.__name__
        if isinstance(error, ValidationError) and error.title == own_title:
            raise  # an error of another model in the plugin's code is the plugin's fault
        guard.raise_named(error, cls, "its construction", PluginError)
    return _guarded(plugin)


def _guarded(plugin: Plugin) -> Plugin:
    """Return the plugin after guarding its methods and those of the plugins in its fields."""
    for one in nested_plugins(plugin):
        guard_class(type(one))
    return plugin


def parse(model: type[SettingsT], values: Mapping[str, Any], where: str = "") -> SettingsT:
    """Validate composed values; an error names the path, after ``where``, and what is allowed."""
    try:
        return model(**at_home(values))
    except ValidationError as error:
        raise ConfigError(explain(error, where, model)) from error


def with_overrides(config: SettingsT, overrides: Mapping[str, Any]) -> SettingsT:
    """Return ``config`` with overrides applied; their keys may be nested or dotted.

    What is chosen by its name, such as an engine or a robot, comes first, whatever the order, as
    groups do on the command line. The collector that ``config`` has keeps its settings if it is
    named again.

    A reward term set to None is dropped; an empty mapping of rewards drops all terms.
    """
    result = to_dict(config)
    for key, value in sorted(overrides.items(), key=lambda item: not _is_named(*item)):
        if key == "rewards" and value == {}:  # it replaces the terms instead of merging into them
            result[key] = {}
        elif key == "logger" and not isinstance(value, Mapping):  # names replace all loggers
            result[key] = loggers_by_name(value)
        elif key == "collector" and isinstance(value, str):  # a name alone, as in commands
            if result.get(key, {}).get("name") != value:
                result[key] = {"name": value}
        elif key == "robot" and isinstance(value, str):
            result[key] = to_dict(named_robot(value))
        else:
            *parents, leaf = key.split(".")
            node = result
            for parent in parents:
                node = node.setdefault(parent, {})
                if not isinstance(node, dict):
                    raise ConfigError(f"{key}: {parent} is a value, not a section; it is {node!r}")
            _merge(node, leaf, value)
    if isinstance(rewards := result.get("rewards"), dict):
        result["rewards"] = {name: term for name, term in rewards.items() if term is not None}
    return parse(type(config), result)


def _is_named(key: str, value: object) -> bool:
    """Return whether an override replaces a section by another one of a name."""
    named = isinstance(value, (str, Plugin)) or (isinstance(value, Mapping) and "name" in value)
    return "." not in key and (named or key in ("collector", "logger"))


def _merge(node: dict[str, Any], key: str, value: Any) -> None:
    old = node.get(key)
    if isinstance(old, dict) and "name" in old and isinstance(value, str):
        node[key] = {"name": value}
    elif isinstance(old, dict) and isinstance(value, Mapping) and "name" not in value:
        for inner, item in value.items():
            _merge(old, inner, item)
    else:  # a copy, since a later override may lie inside it
        node[key] = dict(value) if isinstance(value, Mapping) else value


def to_dict(settings: Settings, *, brief: bool = False) -> dict[str, Any]:
    """Return the plain data from which ``create`` or ``parse`` makes equal settings.

    ``brief``: a plugin inside a plugin is written as its name alone if all its fields have their
    defaults.
    """
    if isinstance(settings, Plugin):
        try:
            return mapping(settings, brief=brief)
        except BaseException as error:  # noqa: BLE001  # raised again
            guard.raise_named(_unwrap(error), settings, "its serialisation", PluginError)
    try:
        return settings.model_dump(mode="json", context={"brief": brief})
    except PydanticSerializationError as error:
        if isinstance(cause := _unwrap(error), FlipperctlError):
            raise cause from error
        raise


def _unwrap(error: BaseException) -> BaseException:
    """Return the error of a plugin's serialiser, which pydantic wraps."""
    wrapped = isinstance(error, PydanticSerializationError) and error.__cause__
    return wrapped or error


def defaults(cls: type[Plugin]) -> dict[str, Any]:
    """Return the brief plain data of a plugin at its defaults.

    A default of null stays null, also if the plugin then chooses by its other fields.
    """
    try:
        found = to_dict(construct(cls, {}), brief=True)
    except ValidationError as error:
        raise ConfigError(
            f"{guard.plugin_label(cls)}: its defaults are not valid: "
            f"{explain(error, '', cls)} ({guard.definition(cls)})"
        ) from error
    chosen = {name for name, info in cls.model_fields.items() if info.default is None}
    return {name: None if name in chosen else value for name, value in found.items()}


def nested_plugins(plugin: Plugin) -> list[Plugin]:
    """Return the plugin and those in its fields, at any depth."""
    found, waiting = [plugin], deque(getattr(plugin, name) for name in type(plugin).model_fields)
    while waiting:
        value = waiting.popleft()
        if isinstance(value, Plugin):
            found += nested_plugins(value)
        elif isinstance(value, tuple | list):
            waiting += value
        elif isinstance(value, Mapping):
            waiting += value.values()
    return found


_CONTRACT = "flipperctl.api"
_guarded_functions: WeakSet[Callable[..., object]] = WeakSet()
"""The guarded functions; an attribute would be copied by an author's ``functools.wraps``."""

_RAISED: dict[tuple[str, str], type[FlipperctlError]] = {
    ("network", "build"): ConfigError,
    ("network", "frames"): ConfigError,
    ("agent", "build"): ConfigError,
    ("reward", "bounds"): PluginError,
}
"""(kind, method) → the error that rejects a plugin before it is used."""
_REFUSALS: dict[tuple[str, str], type[FlipperctlError]] = {
    ("terrain", "at"): TerrainError,
    ("terrain", "generate"): TerrainError,
    ("terrain", "labelled"): TerrainError,
    ("controller", "using"): ConfigError,
    ("controller", "paying"): ConfigError,
}
"""(kind, method) → the error in place of a ValueError, with which the method rejects a request."""
_PASSED_ON: dict[str, type[BaseException]] = {
    **dict.fromkeys(("notices", "check", "check_start"), ValueError),
    "open": BaseException,
}
"""Method → the errors that it passes on unchanged because the caller interprets them."""
_NO_PLUGINS = (float, int, bool, tuple, type(None))
"""Types of results that need no guard."""
_NAMES = {"labelled": "generate"}
"""Method of the contract → the author's method that it calls, which errors name."""


def guard_class(cls: type[Plugin]) -> None:
    """Guard each method and property of the contract, also inherited ones; idempotent.

    They name plugin, method, file and line when they fail in calls by the core: another plugin or
    the author's own test gets the original error and may catch it.
    """
    for base in cls.__mro__:
        if not (base.__module__.startswith(_CONTRACT) and issubclass(base, Plugin)):
            continue
        for name in vars(base):
            if name[0] != "_" or name == "__call__":
                found = next(vars(one)[name] for one in cls.__mro__ if name in vars(one))
                replaced = _guard_attribute(name, found)
                if replaced is not found:
                    setattr(cls, name, replaced)


def _guard_attribute(name: str, found: Any) -> object:
    """Return a guarded version of a method or property; return a plain value unchanged."""
    if isinstance(found, property) and found.fget is not None:
        getter = _guard(name, found.fget)
        return found if getter is found.fget else property(getter, doc=found.__doc__)
    if inspect.isfunction(found):
        return _guard(name, found)
    if isinstance(found, classmethod) and inspect.isfunction(found.__func__):
        method = _guard(name, found.__func__)
        return found if method is found.__func__ else classmethod(method)
    if not hasattr(type(found), "__get__"):
        return found

    @functools.wraps(getattr(found, "func", found))
    def get(self: Plugin, *given: object, **named: object) -> object:
        """Read a cached property; call a static or partial method, or a compiled function."""
        value = found.__get__(self, type(self))
        return value if cached else value(*given, **named)

    cached = isinstance(found, functools.cached_property)
    return property(_guard(name, get), doc=found.__doc__) if cached else _guard(name, get)


def _guard(name: str, function: Callable[..., object]) -> Callable[..., object]:
    """Return a version of the function that names its plugin if it fails in a call by the core."""
    if function in _guarded_functions:
        return function
    shown = _NAMES.get(name, name)

    @functools.wraps(function)
    def guarded(self: Plugin | type[Plugin], *given: object, **named: object) -> object:
        try:
            result = function(self, *given, **named)
        except BaseException as error:
            if isinstance(error, _PASSED_ON.get(name, ())) or not guard.is_called_by_core(error):
                raise
            refuses = isinstance(error, ValueError)
            key = self.kind, name
            if refuses and (refusal := _REFUSALS.get(key)):
                guard.raise_named(error, self, shown, refusal, plain=True)
            guard.raise_named(error, self, shown, _RAISED.get(key, PluginFailedError))
        # Most results are numbers, of which the type is known sooner than that they are no plugin.
        if result.__class__ not in _NO_PLUGINS and isinstance(result, Plugin):
            guard_class(type(result))
        return result

    _guarded_functions.add(guarded)
    return guarded
