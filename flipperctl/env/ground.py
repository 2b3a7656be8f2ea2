"""Calls a terrain plugin and checks its results: profiles and difficulties.

In: a terrain and a random generator. Out: a profile that an engine can simulate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from numbers import Real
from typing import Any

import numpy as np
from pydantic import ValidationError

from flipperctl.api import Profile, Terrain
from flipperctl.config.resolver import construct, nested_plugins
from flipperctl.errors import TerrainError
from flipperctl.plugging.checked import require
from flipperctl.plugging.guard import refusal, refusing, short_repr
from flipperctl.sim.ground import check_extent, thinned
from flipperctl.text.messages import explain

_DIFFICULTY = "difficulty"
LONGEST = 1000.0
"""Longest profile [m]; its episode takes more than an hour of simulated time."""
MOST_POINTS = 100_000
"""Most points of a profile [-]; the tracks feel no shorter edges, and each takes time."""
HIGHEST = 100.0
"""Largest height above or below the first edge [m], the bound of the observation space."""
FARTHEST_END = 10.0
"""Largest distance of a profile's own start or finish from it [m], as in the section episode."""
FARTHEST = 1e7
"""Largest coordinate [m], beyond which floats are too coarse for the contacts' tolerance."""


def generate_profile(terrain: Terrain, rng: np.random.Generator, difficulty: float) -> Profile:
    """Return the checked profile that a terrain generates for an episode."""
    with refusing(terrain, "generate", TerrainError):
        at: Terrain = require(terrain, "at", terrain.at(difficulty))
        if at is not terrain:
            _require_valid(at, terrain)
        profile = at.labelled(rng)
    if fault := next(_faults(profile), None):
        raise refusal(terrain, "generate", f"returned a profile {fault}", TerrainError)
    return profile


def _require_valid(at: Terrain, terrain: Terrain) -> None:
    """Refuse a terrain with settings that its fields or validators do not allow."""
    for part in nested_plugins(at):  # model_copy validates nothing
        cls, values = type(part), dict(part)
        try:
            again = construct(cls, values)
        except ValidationError as error:
            text = f"returned settings that are not allowed: {explain(error, '', cls)}"
            raise refusal(terrain, "at", text, TerrainError) from error
        if again != part:
            text = f"returned {short_repr(part)}; its settings, validated, are {short_repr(again)}"
            raise refusal(terrain, "at", text, TerrainError)


def _faults(profile: Profile) -> Iterator[str]:
    """Yield what is wrong about a generated profile, and what is allowed."""
    # The label and the drawn numbers become texts and columns of tables.
    if not isinstance(profile.label, str):
        yield f"whose label is {short_repr(profile.label)}; a text is allowed"
    if not isinstance(profile.drawn, Mapping):
        yield f"whose drawn numbers are {short_repr(profile.drawn)}; a mapping is allowed"
    for name, value in profile.drawn.items():
        word = isinstance(name, str) and name.isidentifier()
        if not (word and isinstance(value, Real) and math.isfinite(float(value))):
            item = f"{short_repr(name)}: {short_repr(value)}"
            yield f"whose drawn numbers have {item}; words with finite numbers are allowed"
    # Size and place: what engines simulate in reasonable time and precision.
    points, length = profile.points, profile.end - profile.start
    height = float(np.abs(points[:, 1] - points[0, 1]).max())
    limits = (
        (len(points), MOST_POINTS, "points"),
        (float(np.abs(points).max()), FARTHEST, "m as a coordinate"),
        (length, LONGEST, "m of length (is its unit metres?)"),
        (height, HIGHEST, "m above or below its first edge"),  # as in the observation space
    )
    for number, most, what in limits:
        if not number <= most:
            yield f"with {number:g} {what}; at most {most:g} is allowed"
    # A start or finish of the profile's own lies on it, or a little beyond.
    for name in ("run_up", "run_out"):
        distance = getattr(profile, name)
        if distance is not None and not -length <= distance <= FARTHEST_END:
            yield f"whose {name} is {distance:g} m; {-length:g} m to {FARTHEST_END:g} m is allowed"


def prepare_profile(profile: Profile, terrain: Terrain, track_radius: float) -> Profile:
    """Return the profile without details that tracks of this radius [m] cannot feel."""
    try:
        felt = thinned(profile, track_radius)
        check_extent(felt)
    except ValueError as error:
        text = f"returned ground that cannot be driven on: {error}"
        raise refusal(terrain, "generate", text, TerrainError) from error
    return felt


def asked_difficulty(options: Mapping[str, Any] | None) -> float:
    """Return the difficulty among the options of a reset, by default 1."""
    for name in options or ():
        if name != _DIFFICULTY:
            raise ValueError(f"options: {name!r:.60}; {_DIFFICULTY!r} is allowed")
    difficulty: Any = (options or {}).get(_DIFFICULTY, 1.0)
    known = isinstance(difficulty, Real)
    if not known or not 0 <= difficulty <= 1:  # false for NaN
        raise ValueError(f"there is no difficulty {difficulty!r}; 0 to 1 is allowed")
    return float(difficulty)


def first_difficulty(terrain: Terrain) -> float:
    """Return the difficulty of a training's first episode."""
    return float(require(terrain, "first_difficulty", terrain.first_difficulty))


def next_difficulty(terrain: Terrain, difficulty: float, reached: bool) -> float:
    """Return the difficulty after an episode that did or did not reach the finish."""
    following = terrain.next_difficulty(difficulty, reached)
    return float(require(terrain, "next_difficulty", following))
