"""Terrains, and fields that take one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
from pydantic import BeforeValidator, PlainSerializer, SerializationInfo
from pydantic_core import PydanticCustomError

from flipperctl.api.plugin import Plugin, register, registry
from flipperctl.api.values import Profile


class Terrain(Plugin, ABC):
    """Draws the ground of an episode."""

    kind: ClassVar[str] = "terrain"

    @abstractmethod
    def generate(self, rng: np.random.Generator) -> Profile:
        """A profile; every random choice comes from ``rng``."""

    @property
    def first_difficulty(self) -> float:
        """Difficulty of the first episode of a training, 0 to 1."""
        return 1.0

    def next_difficulty(self, difficulty: float, reached: bool) -> float:
        """Difficulty of the episodes behind one that did or did not reach the finish, 0 to 1."""
        return difficulty

    def at(self, difficulty: float) -> Terrain:
        """The terrain from which a training at this difficulty draws; itself is that of 1."""
        return self

    def labelled(self, rng: np.random.Generator) -> Profile:
        """What ``generate`` draws; without a label it gets the terrain's name.

        Raises:
            ValueError: it is no profile.
        """
        profile = self.generate(rng)
        if not isinstance(profile, Profile):
            found = type(profile).__name__
            raise ValueError(f"generate must return a Profile; it returned a {found}")
        return profile if profile.label else Profile(profile.points, self.plugin_name)


def _nested_terrain(value: object) -> object:
    """The terrain meant by its name, or by a mapping with ``name`` and its fields."""
    if isinstance(value, Terrain):
        return value
    if isinstance(value, str):
        value = {"name": value}
    if not isinstance(value, Mapping) or "name" not in value:
        raise ValueError("a terrain's name, or a mapping with 'name' and its fields, is allowed")
    cls = registry.get(("terrain", str(value["name"])))
    if cls is None:
        known = sorted(name for kind, name in registry if kind == "terrain")
        context = {"kind": "terrain", "name": str(value["name"]), "known": known}
        raise PydanticCustomError("unknown_plugin", "there is no {kind} plugin '{name}'", context)
    return cls(**{key: field for key, field in value.items() if key != "name"})


def _nested_container(plugin: Plugin, info: SerializationInfo) -> Any:
    """What ``_nested_terrain`` takes; in the context ``brief`` a name alone if it says it all."""
    context = info.context or {}
    if context.get("brief") and plugin == type(plugin)():
        return plugin.plugin_name
    fields = plugin.model_dump(mode="json", context=context)
    return {"name": plugin.plugin_name, **fields}


AnyTerrain = Annotated[
    Terrain, BeforeValidator(_nested_terrain), PlainSerializer(_nested_container)
]
"""The type of a field that takes another terrain: an instance, a name, or a mapping."""


TerrainT = TypeVar("TerrainT", bound=Terrain)


def terrain(name: str) -> Callable[[type[TerrainT]], type[TerrainT]]:
    """Register a ``Terrain`` under ``name``; ``terrain=<name>`` then works everywhere."""
    return register(Terrain, name)
