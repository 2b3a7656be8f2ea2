"""The defaults from which a configuration is composed: of each plugin, variant and section.

In: the registry and the models. Out: entries of groups, of which one is chosen by name, and the
sections that are not chosen.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

from flipperctl.api import Logger, Measure, registry
from flipperctl.api.plugin import registered_names
from flipperctl.config import resolver
from flipperctl.config.loggers import METRICS_ALONE
from flipperctl.config.models import EvalConfig, TrainConfig
from flipperctl.config.sections import LocalCollector, RayCollector
from flipperctl.config.teacher import Teacher
from flipperctl.errors import ConfigError
from flipperctl.messages import close_match, missing_name

GROUPS = (
    *("terrain", "robot", "rewards", "network", "collector", "teacher", "logger"),
    *("sim", "perception", "conditions"),
)
"""Groups whose choice is stored under a key of the same name."""
CHOICES = (*GROUPS, "controller", "experiment")
"""Keys whose value is a name that brings other keys."""
LISTS = (Logger.kind,)
"""Groups of which several entries may be chosen, each stored under its name below the group."""
_ENTRY_NAMES = {"rewards": "preset", "conditions": "set"}
"""The noun for an entry, where it is not the group's name."""


def entries() -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield group, name and settings of each registered plugin, collector and teacher."""
    teaching = resolver.to_dict(Teacher())
    yield "teacher", "none", teaching
    # The empty name is refused with what to give, so that teacher=recorded never means no teacher.
    yield "teacher", "recorded", {**teaching, "episodes": ""}
    yield Logger.kind, METRICS_ALONE, {}
    for (kind, name), cls in registry.items():
        if kind == Measure.kind:
            continue  # every measure is taken of every episode; none is chosen
        defaults = resolver.defaults(cls)
        yield kind, name, defaults
        if kind == "controller":
            own = getattr(cls, "reference_settings", {})
            yield "teacher", name, {**teaching, "controller": {**defaults, **own}}
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

    ``path``: the setting that was to have the entry; None for the one with the group's name.
    """
    plugin = bool(registered_names(group))
    what = f"{group} plugin" if plugin else _ENTRY_NAMES.get(group, group)
    hint = missing_name(group, name, known) if plugin else close_match(name, known)
    return ConfigError(
        f"{path or group}: there is no {what} {name!r}{hint}; "
        f"known: {', '.join(sorted(known)) or 'none'}"
    )
