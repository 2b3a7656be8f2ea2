"""Terrains, and the type of a field that takes a terrain."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
from pydantic import BeforeValidator, PlainSerializer, SerializationInfo
from pydantic_core import PydanticCustomError

from flipperctl.api.plugin import Plugin, mapping, register, registered_names, selected
from flipperctl.api.profile import Profile


@dataclass(frozen=True)
class Published:
    """What someone measured on a terrain at its defaults, for ``eval`` to show beside its own."""

    source: str
    """Who measured it, and with what, in a word or two."""
    conditions: str
    """The ``conditions=`` that repeat the experiment; under others nothing is shown."""
    t_cost: float
    """Mean time from start to finish [s]."""
    pitch_variation: float
    """Mean θ̂_R at decisions [rad]."""
    pitch_variation_range: float
    """Largest minus smallest θ̂_R at decisions [rad]."""


class Terrain(Plugin, ABC):
    """Generates the ground of an episode."""

    kind: ClassVar[str] = "terrain"
    published: ClassVar[tuple[Published, ...]] = ()
    """Published results on this terrain, all of one experiment."""

    @abstractmethod
    def generate(self, rng: np.random.Generator) -> Profile:
        """Return a profile; every random choice is sampled from ``rng``."""

    @property
    def title(self) -> str:
        """Name of the ground for people, by default the plugin's."""
        return self.plugin_name

    @property
    def first_difficulty(self) -> float:
        """Difficulty of the first episode of a training, from 0 to 1."""
        return 1.0

    def next_difficulty(self, difficulty: float, reached: bool) -> float:
        """Return the next difficulty, from 0 to 1; ``reached``: whether the episode succeeded."""
        return difficulty

    def at(self, difficulty: float) -> Terrain:
        """Return this terrain configured for ``difficulty``; at 1 it is unchanged."""
        return self

    def labelled(self, rng: np.random.Generator) -> Profile:
        """Return a generated profile; its label defaults to the terrain's title.

        Raises:
            ValueError: ``generate`` returned something other than a profile.
        """
        profile = self.generate(rng)
        if not isinstance(profile, Profile):
            kind = type(profile).__name__
            raise ValueError(f"generate must return a Profile; it returned a {kind}")
        if profile.label:
            return profile
        return replace(profile, label=self.title)


def _nested_terrain(value: object) -> object:
    """Return the terrain that a name, or a mapping with ``name`` and fields, selects."""
    if isinstance(value, Terrain):
        return value
    try:
        cls, fields = selected("terrain", value)
    except TypeError as error:
        raise ValueError(
            "a terrain's name, or a mapping with 'name' and its fields, is allowed"
        ) from error
    except LookupError as error:
        known = registered_names("terrain")
        name = value["name"] if isinstance(value, Mapping) else value
        context = {"kind": "terrain", "name": str(name), "known": known}
        raise PydanticCustomError(
            "unknown_plugin", "there is no {kind} plugin '{name}'", context
        ) from error
    return cls(**fields)


def _nested_mapping(plugin: Plugin, info: SerializationInfo) -> Any:
    """Return a mapping that ``_nested_terrain`` accepts; if brief and at its defaults, the name."""
    brief = bool((info.context or {}).get("brief"))
    if brief and plugin == type(plugin)():
        return plugin.plugin_name
    return mapping(plugin, brief=brief)


AnyTerrain = Annotated[Terrain, BeforeValidator(_nested_terrain), PlainSerializer(_nested_mapping)]
"""The type of a field that takes another terrain: an instance, a name, or a mapping."""


TerrainT = TypeVar("TerrainT", bound=Terrain)


def terrain(name: str) -> Callable[[type[TerrainT]], type[TerrainT]]:
    """Register a ``Terrain`` under ``name``; ``terrain=<name>`` then works everywhere."""
    return register(Terrain, name)
