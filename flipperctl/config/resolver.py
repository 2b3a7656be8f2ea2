"""Convert names and overrides to validated settings, and settings to plain data.

In: a plugin's or a robot's name, composed values, overrides. Out: frozen settings with plugin
instances inside. Every composed configuration (by Hydra, from a checkpoint, from keyword arguments,
by ``--resume``) passes through ``parse``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticSerializationError

from flipperctl.api import Plugin, Robot, Settings, registry
from flipperctl.api.plugin import mapping, registered_names
from flipperctl.config import strict_yaml
from flipperctl.config.presets import presets
from flipperctl.errors import ConfigError, FlipperctlError, PluginError
from flipperctl.plugging import guard
from flipperctl.text.files import at_home
from flipperctl.text.messages import broken_hint, close_match, explain, missing_name

ModelT = TypeVar("ModelT", bound=BaseModel)

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
        settings = strict_yaml.read(Path(name), where)
    elif name in known:
        settings = strict_yaml.read(known[name], where)
    else:
        raise ConfigError(
            f"robot: there is no robot {name!r}{close_match(name, known) or broken_hint()}; "
            f"known: {', '.join(known)}; a file of your own ends in .yaml"
        )
    if not isinstance(settings, dict):
        raise ConfigError(
            f"{where}: settings of the robot are allowed, as in chassis_length: 0.7; known: "
            f"{', '.join(Robot.model_fields)}"
        )
    settings.pop("devices", None)  # which are not the robot's body
    return parse(Robot, settings, where)


def get(kind: str, name: object, where: str) -> type[Plugin]:
    """Return the class registered under ``name``."""
    if cls := registry.get((kind, str(name))):
        return cls
    known = registered_names(kind)
    raise ConfigError(
        f"{where}: there is no {kind} plugin {name!r}{missing_name(str(name), known)}; "
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
        return settings
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
    """Return an instance of a plugin; an error of its own code names it."""
    try:
        return cls(**fields)
    except BaseException as error:
        own_title = cls.model_config.get("title") or cls.__name__
        if isinstance(error, ValidationError) and error.title == own_title:
            raise  # an error of another model in the plugin's code is the plugin's fault
        guard.raise_named(error, cls, "its construction", PluginError)


def parse(model: type[ModelT], values: Any, where: str = "") -> ModelT:
    """Validate composed values; an error names the path, after ``where``, and what is allowed."""
    try:
        return model.model_validate(at_home(values))
    except ValidationError as error:
        raise ConfigError(explain(error, where, model)) from error


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
        plain = to_dict(construct(cls, {}), brief=True)
    except ValidationError as error:
        raise ConfigError(
            f"{guard.plugin_label(cls)}: its defaults are not valid: "
            f"{explain(error, '', cls)} ({guard.definition(cls)})"
        ) from error
    null_by_default = {name for name, info in cls.model_fields.items() if info.default is None}
    return {name: None if name in null_by_default else value for name, value in plain.items()}


def nested_plugins(plugin: Plugin) -> list[Plugin]:
    """Return the plugin and those in its fields, at any depth."""
    plugins, waiting = [plugin], deque(getattr(plugin, name) for name in type(plugin).model_fields)
    while waiting:
        value = waiting.popleft()
        if isinstance(value, Plugin):
            plugins += nested_plugins(value)
        elif isinstance(value, tuple | list):
            waiting += value
        elif isinstance(value, Mapping):
            waiting += value.values()
    return plugins
