"""Sample the profiles of a terrain as its episodes have them, and describe their sizes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from flipperctl.api import Profile
from flipperctl.config import EnvConfig
from flipperctl.env.flipper_env import FlipperEnv


def sample(config: EnvConfig, seeds: Iterable[int]) -> list[tuple[Profile, dict[str, Any]]]:
    """Return the profile of the episode with each seed, and its description as plain data.

    Raises:
        TerrainError: a profile is one that no robot can start on.
    """
    env = FlipperEnv(config=config)
    found = []
    for seed in seeds:
        env.reset(seed=seed)  # as in an episode, so that invalid profiles are found here
        description = {**describe(env.profile), "drawn": dict(env.profile.drawn)}
        description["points_drawn"] = env.points_drawn
        found.append((env.profile, {"seed": seed, **description}))
    return found


def describe(profile: Profile) -> dict[str, Any]:
    """Return the extent, heights and steepness of a profile, and its points in world [m]."""
    points = profile.points
    steps = np.diff(points, axis=0)  # (V - 1, 2) [m]
    faces = steps[steps[:, 0] == 0, 1]
    slopes = np.degrees(np.arctan2(steps[:, 1], steps[:, 0]))[steps[:, 0] > 0]
    return {
        "length": float(profile.end - profile.start),
        "lowest": float(points[:, 1].min()),
        "highest": float(points[:, 1].max()),
        "climb": float(points[-1, 1] - points[0, 1]),
        "largest_face": float(np.abs(faces).max(initial=0.0)),
        "steepest_slope_degrees": float(np.abs(slopes).max(initial=0.0)),
        "points": points.tolist(),
    }
