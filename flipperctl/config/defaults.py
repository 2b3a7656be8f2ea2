"""The defaults from which a configuration is composed: of each plugin, variant and section.

In: the registry and the models. Out: entries of groups, which are chosen by name, and the sections
that are not chosen. Also: notices of plugins, sentences on robots that do not fit their conditions,
and errors for overrides of settings that are sampled anew for every episode.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from typing import Any

from flipperctl.api import Learner, Logger, Measure, Plugin, Robot, registry
from flipperctl.api.plugin import registered_names
from flipperctl.config import resolver
from flipperctl.config.models import EnvConfig, EvalConfig, TrainConfig
from flipperctl.config.sections import LocalCollector, RayCollector
from flipperctl.config.teacher import Teacher
from flipperctl.errors import ConfigError
from flipperctl.plugging.guard import plugin_label
from flipperctl.text.messages import broken_hint, close_match, missing_name

_ALIKE = 0.02
"""Relative difference of lengths that makes none [-]."""


def notices(config: EnvConfig) -> Iterator[str]:
    """Yield what the plugins of a validated configuration say of their data, and of its robot."""
    for value in (getattr(config, name) for name in type(config).model_fields):
        for item in value.values() if isinstance(value, dict) else (value,):
            for plugin in resolver.nested_plugins(item) if isinstance(item, Plugin) else ():
                with suppress(ValueError):  # the use of the plugin raises it, which says why
                    yield from (f"{plugin_label(plugin)}: {text}" for text in plugin.notices())
    yield from notes_on_robot(config)


def notes_on_robot(config: EnvConfig) -> Iterator[str]:
    """Yield a line for each sampled range, and for a body, that another robot does not fit.

    The named conditions have ranges for nubot; with another robot, its own value may lie outside.
    A sensor's body, which hides ground, should be as long as the chassis.
    """
    # Ranges of conditions that leave the robot itself out
    robot, perception = config.robot, config.perception
    for sampled in config.randomise.sampled():
        configured, (low, high) = getattr(robot, sampled.field, None), sampled.ends
        if sampled.section != "robot" or configured is None:  # a factor, or a load of none
            continue
        if (
            configured != Robot.model_fields[sampled.field].default
            and not low <= configured <= high
        ):
            yield (
                f"{sampled.key}: no episode has the robot's robot.{sampled.field}="
                f"{configured:.4g}, since its range is {low:g} to {high:g}; give a range around "
                f"it, or {sampled.key}=null"
            )

    # A body that hides more or less ground than the chassis does
    body, length = getattr(perception, "body_length", None), robot.chassis_length
    hides = config.randomise.find("perception", "occlusion") or getattr(
        perception, "occlusion", False
    )
    if hides and body is not None and abs(body - length) > _ALIKE * length:
        yield (
            f"perception.body_length: a body of {body:.4g} m hides the ground below it, and the "
            f"robot.chassis_length is {length:.4g} m; perception.body_length={length:.4g} hides all"
        )


_COLLECTING = ("collector", "train.mode", "train.workers")


def refuse_ineffective(config: EnvConfig, overrides: Mapping[str, str]) -> None:
    """Refuse an override of a setting that is sampled anew for every episode.

    With a learner that plays its episodes itself, overrides of the collectors are refused, too.

    ``overrides`` holds the overridden keys, and the override of each as it was typed.

    With ``randomise.spread``, samples lie around the value of the setting, which then has one. All
    settings of the robot at once come from a file, ``robot=FILE``; some of them may be sampled.
    """
    # Collectors play nothing for a learner that plays itself.
    if isinstance(config, TrainConfig) and config.agent.own_loop:
        for key, typed in overrides.items():
            if key.startswith(_COLLECTING):
                name = config.agent.plugin_name
                raise ConfigError(
                    f"{typed}: it has no effect with agent={name}, which plays its episodes itself"
                )

    # A sampled value replaces the setting, unless ``spread`` samples around it.
    if config.randomise.spread is not None:
        return
    whole = all(f"robot.{field}" in overrides for field in type(config.robot).model_fields)
    for key, typed in overrides.items():
        if whole and key.startswith("robot."):
            continue
        for sampled in config.randomise.sampled():
            # The nominal turning rate still sets the decision period.
            if key == f"{sampled.section}.{sampled.field}" and sampled.field != "flipper_speed":
                value = sampled.value
                shown = "[{:g},{:g}]".format(*value) if isinstance(value, tuple) else f"{value:g}"
                raise ConfigError(
                    f"{typed}: it has no effect, since {sampled.key}={shown} "
                    f"samples it for every episode; add {sampled.key}=null, or change that value"
                )


GROUPS = (
    "terrain",
    "robot",
    "rewards",
    "network",
    "agent",
    "collector",
    "teacher",
    "logger",
    "sim",
    "perception",
    "conditions",
)
"""Groups whose choice is stored under a key of the same name."""
CHOICES = (*GROUPS, "controller", "experiment")
"""Keys whose value is a name that brings other keys."""
LISTS = (Logger.kind,)
"""Groups with several entries at a time, each stored under its name below the group."""
_ENTRY_NAMES = {"rewards": "preset", "conditions": "set"}
"""The noun for an entry, where it is not the group's name."""


def entries() -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield group, name and settings of each registered plugin, collector and teacher."""
    teaching = resolver.to_dict(Teacher())
    yield "teacher", "none", teaching
    # The empty name is refused with what to give, so that teacher=recorded never means no teacher.
    yield "teacher", "recorded", {**teaching, "episodes": ""}
    yield Logger.kind, resolver.METRICS_ALONE, {}

    # Plugins, with what comes along with some of them
    for (kind, name), cls in registry.items():
        if kind == Measure.kind:
            continue  # every measure is taken of every episode; none is chosen
        defaults = resolver.defaults(cls)
        if issubclass(cls, Learner) and (network := cls.default_network):
            choice = [{"override /network": network}, "_self_"]
            yield kind, name, {"defaults": choice, kind: defaults}
            continue
        yield kind, name, defaults
        if kind == "controller":
            reference = getattr(cls, "reference_settings", {})
            yield "teacher", name, {**teaching, "controller": {**defaults, **reference}}
    for collector in (LocalCollector(), RayCollector()):
        yield "collector", collector.name, resolver.to_dict(collector)


def sections(model: type[TrainConfig | EvalConfig]) -> dict[str, Any]:
    """Return the fields of a whole configuration that no group chooses, at their defaults."""
    return {
        name: resolver.to_dict(info.default)
        if hasattr(info.default, "model_dump")
        else info.default
        for name, info in model.model_fields.items()
        if name not in GROUPS
    }


def missing_entry(
    group: str, name: str, known: Collection[str], path: str | None = None
) -> ConfigError:
    """Return the error for a group that has no entry of this name, as in ``terrain=stiar``.

    ``path``: the setting that was to have the entry; None for the setting with the group's name.
    """
    plugin = bool(registered_names(group))
    what = f"{group} plugin" if plugin else _ENTRY_NAMES.get(group, group)
    hint = missing_name(name, known) if plugin else close_match(name, known) or broken_hint()
    return ConfigError(
        f"{path or group}: there is no {what} {name!r}{hint}; "
        f"known: {', '.join(sorted(known)) or 'none'}"
    )
