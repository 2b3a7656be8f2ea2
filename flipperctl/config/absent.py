"""Stand-ins for a training's terrain and reward terms whose plugins are missing.

In: a plain configuration, and the files that its plugins came from. Out: the same, with a stand-in
in place of each terrain or reward term whose plugin is missing. A policy can be evaluated without
them on another terrain; a stand-in raises when it is used.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, NoReturn

import numpy as np
from pydantic import ConfigDict

from flipperctl.api import RewardTerm, Terrain, Transition, registry
from flipperctl.errors import PluginError
from flipperctl.messages import missing_plugin

Files = Mapping[tuple[str, str], str | Path]
"""(kind, name) of a plugin → the name of the file that it came from, or the path of a copy."""


class AbsentTerrain(Terrain):
    """Keep the settings of a terrain whose plugin, or that of a terrain inside it, is missing."""

    model_config = ConfigDict(extra="allow")
    missing: ClassVar[str]
    """What is missing, and how to get it."""

    def generate(self, rng: np.random.Generator) -> NoReturn:
        """Raise a PluginError."""
        raise PluginError(self.missing)


class AbsentReward(RewardTerm):
    """Keep the settings of a reward term whose plugin is missing."""

    model_config = ConfigDict(extra="allow")
    missing: ClassVar[str]
    """What is missing, and how to get it."""

    def __call__(self, t: Transition) -> NoReturn:
        """Raise a PluginError."""
        raise PluginError(self.missing)


def with_stand_ins(settings: Mapping[str, Any], files: Files) -> dict[str, Any]:
    """Return a plain configuration with stand-ins where terrain or reward plugins are missing.

    A missing teacher's controller and missing loggers are left out, since only a training needs
    them.
    """
    result = dict(settings)
    result["terrain"] = _or_stand_in(AbsentTerrain, settings["terrain"], files)
    if "rewards" in settings:
        terms = settings["rewards"]
        result["rewards"] = {k: _or_stand_in(AbsentReward, v, files) for k, v in terms.items()}
    teacher = settings.get("teacher") or {}
    if any(_missing_names("controller", teacher.get("controller"))):
        result["teacher"] = {**teacher, "controller": None}
    loggers = settings.get("logger") or {}
    if "logger" in settings:
        result["logger"] = {
            k: v for k, v in loggers.items() if not any(_missing_names("logger", v))
        }
    return result


def _or_stand_in(family: type[AbsentTerrain | AbsentReward], settings: Any, files: Files) -> Any:
    """Return the settings, or a stand-in if a plugin that they name is missing."""
    kind = family.kind
    name = next(_missing_names(kind, settings), None)
    if name is None:
        return settings
    text = missing_plugin(kind, name, files.get((kind, name)))
    fields = dict(settings)
    own: dict[str, Any] = {"plugin_name": fields.pop("name"), "missing": text}
    stand_in = type(family.__name__, (family,), {**own, "__module__": __name__})
    return stand_in(**fields)


def _missing_names(kind: str, settings: Any) -> Iterator[str]:
    """Yield the names of missing plugins in the settings of a plugin, at any depth."""
    if isinstance(settings, Mapping):
        name = settings.get("name")
        if isinstance(name, str) and (kind, name) not in registry:
            yield name
        settings = settings.values()
    elif not isinstance(settings, list | tuple):
        return
    for inner in settings:
        yield from _missing_names(kind, inner)
