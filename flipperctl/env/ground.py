"""What a terrain plugin answers, checked: the profile that it generates, and difficulties.

In: a terrain and the episode's generator. Out: a profile that the engine can bear.
"""

from __future__ import annotations

from numbers import Real
from typing import Any

import numpy as np

from flipperctl.api import Profile, Terrain
from flipperctl.errors import PluginFailedError, TerrainError
from flipperctl.guard import fault, refusal, shown
from flipperctl.sim.ground import check_extent, thinned

LONGEST = 1000.0
"""From the first edge to the last [m]; an episode of that length takes hours of robot's time."""
HIGHEST = 100.0
"""Above or below the first edge [m], as the observation space says."""
FARTHEST = 1e7
"""Of a coordinate [m]: beyond it, numbers lie too close to the contacts' tolerance."""


def draw(terrain: Terrain, rng: np.random.Generator, difficulty: float) -> Profile:
    """The profile of an episode.

    Raises:
        TerrainError: the terrain gives no ground that a robot can start on: ``generate`` raised a
            ValueError, which is its way to say so, or its profile is none that the engine can bear.
        PluginFailedError: it raised anything else.
    """
    method = "at"
    try:
        at = terrain.at(difficulty)
        if not isinstance(at, Terrain):
            raise refusal(terrain, "at", f"returned {_a(at)}; a Terrain is allowed")
        method = "generate"
        profile = at.labelled(rng)
        _check(profile, terrain)
    except ValueError as error:
        raise fault(error, terrain, method, TerrainError, plain=True) from error
    except BaseException as error:
        raise fault(error, terrain, method) from error
    return profile


def _check(profile: Profile, terrain: Terrain) -> None:
    def refuse(text: str) -> TerrainError:
        return TerrainError(str(refusal(terrain, "generate", text)))

    if not isinstance(profile.label, str):
        raise refuse(f"returned a profile whose label is {_a(profile.label)}; a str is allowed")
    points = profile.points
    farthest = float(np.abs(points).max())
    if not farthest <= FARTHEST:
        raise refuse(
            f"returned a profile with a coordinate of {farthest:g} m; at most {FARTHEST:g} m is "
            "allowed, before and behind 0"
        )
    length = profile.end - profile.start
    if length > LONGEST:
        raise refuse(f"returned a profile {length:g} m long; at most {LONGEST:g} m is allowed")
    height = float(np.abs(points[:, 1] - points[0, 1]).max())
    if height > HIGHEST:
        raise refuse(
            f"returned a profile that leads {height:g} m above or below its first edge; at most "
            f"{HIGHEST:g} m is allowed, as in the observation space"
        )


def prepared(profile: Profile, terrain: Terrain, track_radius: float) -> Profile:
    """Return the profile as it is driven on: without what tracks of this radius [m] cannot feel.

    Raises:
        TerrainError: what is left has too many points or too long an outline.
    """
    try:
        felt = thinned(profile, track_radius)
        check_extent(felt)
    except ValueError as error:
        text = f"returned ground that cannot be driven on: {error}"
        raise refusal(terrain, "generate", text, TerrainError) from error
    return felt


def first_difficulty(terrain: Terrain) -> float:
    """The difficulty of a training's first episode.

    Raises:
        PluginFailedError: the terrain raised, or gave no number from 0 to 1.
    """
    try:
        value: object = terrain.first_difficulty
    except BaseException as error:
        raise fault(error, terrain, "first_difficulty") from error
    return _difficulty(value, terrain, "first_difficulty")


def next_difficulty(terrain: Terrain, difficulty: float, reached: bool) -> float:
    """The difficulty after an episode that did or did not reach the finish.

    Raises:
        PluginFailedError: the terrain raised, or gave no number from 0 to 1.
    """
    try:
        value: object = terrain.next_difficulty(difficulty, reached)
    except BaseException as error:
        raise fault(error, terrain, "next_difficulty") from error
    return _difficulty(value, terrain, "next_difficulty")


def _difficulty(value: object, terrain: Terrain, method: str) -> float:
    if isinstance(value, Real) and 0 <= float(value) <= 1:  # a NaN is not
        return float(value)
    raise refusal(
        terrain,
        method,
        f"returned {shown(value)}; a number from 0 to 1 is allowed",
        PluginFailedError,
    )


def _a(value: Any) -> str:
    return f"a {type(value).__name__}, {shown(value)}"
