"""Calls a terrain plugin and checks its results: profiles and difficulties.

In: a terrain and a random generator. Out: a profile that an engine can simulate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np

from flipperctl.api import Profile, Terrain
from flipperctl.errors import PluginFailedError, TerrainError
from flipperctl.guard import refusal, short_repr
from flipperctl.sim.ground import check_extent, thinned

LONGEST = 1000.0
"""Longest profile [m]; its episode takes more than an hour of simulated time."""
HIGHEST = 100.0
"""Largest height above or below the first edge [m], the bound of the observation space."""
FARTHEST_END = 10.0
"""Largest distance of a profile's own start or finish from it [m], as in the section episode."""
FARTHEST = 1e7
"""Largest coordinate [m], beyond which floats are too coarse for the contacts' tolerance."""


def generate_profile(terrain: Terrain, rng: np.random.Generator, difficulty: float) -> Profile:
    """Return the checked profile that a terrain generates for an episode.

    Raises:
        TerrainError: the terrain raised a ValueError because it has no ground, or the profile
            exceeds the bounds of length, height or coordinates.
        PluginFailedError: the terrain raised any other error.
    """
    at = terrain.at(difficulty)
    if not isinstance(at, Terrain):
        raise refusal(terrain, "at", f"returned {_typed_repr(at)}; a Terrain is allowed")
    profile = at.labelled(rng)
    _check(profile, terrain)
    return profile


def _check(profile: Profile, terrain: Terrain) -> None:
    def refuse(text: str) -> TerrainError:
        return TerrainError(str(refusal(terrain, "generate", text)))

    if not isinstance(profile.label, str):
        raise refuse(
            f"returned a profile whose label is {_typed_repr(profile.label)}; a str is allowed"
        )
    if (fault := _drawn_fault(profile.drawn)) is not None:
        raise refuse(f"returned a profile whose drawn numbers {fault}")
    points = profile.points
    farthest = float(np.abs(points).max())
    if not farthest <= FARTHEST:
        raise refuse(
            f"returned a profile with a coordinate of {farthest:g} m; at most {FARTHEST:g} m is "
            "allowed, on either side of 0"
        )
    length = profile.end - profile.start
    if length > LONGEST:
        raise refuse(
            f"returned a profile {length:g} m long; at most {LONGEST:g} m is allowed "
            "(is its unit metres?)"
        )
    height = float(np.abs(points[:, 1] - points[0, 1]).max())
    if height > HIGHEST:
        raise refuse(
            f"returned a profile that is {height:g} m above or below its first edge; at most "
            f"{HIGHEST:g} m is allowed, as in the observation space"
        )

    for name in ("run_up", "run_out"):
        own = getattr(profile, name)
        if own is not None and not -length <= own <= FARTHEST_END:
            raise refuse(
                f"returned a profile whose {name} is {own:g} m; {-length:g} m to "
                f"{FARTHEST_END:g} m is allowed"
            )


def _drawn_fault(drawn: object) -> str | None:
    """Return what is wrong about a profile's drawn numbers; None if nothing is."""
    if not isinstance(drawn, Mapping):
        return f"are {_typed_repr(drawn)}; a mapping is allowed"
    for name, value in drawn.items():
        if not (isinstance(name, str) and name.isidentifier()):
            return f"have the name {short_repr(name)}; a word such as 'steps' is allowed"
        if not (isinstance(value, Real) and math.isfinite(float(value))):
            return f"have {name} = {short_repr(value)}; a finite number is allowed"
    return None


def prepare_profile(profile: Profile, terrain: Terrain, track_radius: float) -> Profile:
    """Return the profile without details that tracks of this radius [m] cannot feel.

    Raises:
        TerrainError: the thinned profile has too many points or too long an outline.
    """
    try:
        felt = thinned(profile, track_radius)
        check_extent(felt)
    except ValueError as error:
        text = f"returned ground that cannot be driven on: {error}"
        raise refusal(terrain, "generate", text, TerrainError) from error
    return felt


def asked_difficulty(options: Mapping[str, Any] | None) -> float:
    """Return the difficulty among the options of a reset, by default 1.

    Raises:
        ValueError: it is not a number from 0 to 1.
    """
    found = (options or {}).get("difficulty", 1.0)
    known = isinstance(found, Real)
    if not known or not 0 <= found <= 1:  # false for NaN
        raise ValueError(f"there is no difficulty {found!r}; 0 to 1 is allowed")
    return float(found)


def first_difficulty(terrain: Terrain) -> float:
    """Return the difficulty of a training's first episode.

    Raises:
        PluginFailedError: the terrain raised an error, or returned no number from 0 to 1.
    """
    return _difficulty(terrain.first_difficulty, terrain, "first_difficulty")


def next_difficulty(terrain: Terrain, difficulty: float, reached: bool) -> float:
    """Return the difficulty after an episode that did or did not reach the finish.

    Raises:
        PluginFailedError: the terrain raised an error, or returned no number from 0 to 1.
    """
    following = terrain.next_difficulty(difficulty, reached)
    return _difficulty(following, terrain, "next_difficulty")


def _difficulty(value: object, terrain: Terrain, method: str) -> float:
    if isinstance(value, Real) and 0 <= float(value) <= 1:  # false for NaN
        return float(value)
    raise refusal(
        terrain,
        method,
        f"returned {short_repr(value)}; a number from 0 to 1 is allowed",
        PluginFailedError,
    )


def _typed_repr(value: Any) -> str:
    return f"a {type(value).__name__}, {short_repr(value)}"
