"""What stands beside the way in 3-D: walls or posts, which sensors see and nothing touches.

In: the engine's settings, the length of the ground and a generator. Out: shapes of a body that is
fixed to the world. It takes part in no contact, so that the motion is equal bit for bit without it.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from flipperctl.api import Profile
from flipperctl.sim.mujoco.settings import MujocoSettings
from flipperctl.sim.mujoco.surface import LEVEL_GROUND

_HEIGHT = 2.5  # of walls and posts above the highest ground [m]
_THICK = 0.1  # of walls [m]
_BEFORE = 6.0  # length of the scenery before the first edge and past the last one [m]
_BETWEEN = 0.8, 2.0  # smallest and largest distance between posts [m]
_RADIUS = 0.05, 0.15  # smallest and largest radius of posts [m]
_BEHIND = 0.5  # largest distance of a post behind the line [m]
_COLOURS = {"walls": [0.8, 0.78, 0.72, 1.0], "posts": [0.45, 0.33, 0.22, 1.0]}


def add_scenery(spec: Any, profile: Profile, sim: MujocoSettings, rng: np.random.Generator) -> None:
    """Add walls or posts to a model; posts are placed at random by ``rng``."""
    if sim.scenery == "none":
        return
    body = spec.worldbody.add_body(name="scenery")
    ends = profile.start - _BEFORE, profile.end + _BEFORE
    low, high = (float(f(profile.points[:, 1])) for f in (np.min, np.max))
    half = (high + _HEIGHT - low) / 2 + 0.1
    shared = {"contype": 0, "conaffinity": 0, "density": 0.0, "rgba": _COLOURS[sim.scenery]}
    for side in (1.0, -1.0):
        if sim.scenery == "walls":
            # As long as the ground, so that no ray passes by their ends
            length = (profile.end - profile.start) / 2 + LEVEL_GROUND
            middle = (profile.start + profile.end) / 2
            y = side * (sim.scenery_distance + _THICK / 2)
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=[middle, y, low - 0.1 + half],
                size=[length, _THICK / 2, half],
                **shared,
            )
            continue
        x = ends[0]
        while (x := x + rng.uniform(*_BETWEEN)) < ends[1]:
            radius = rng.uniform(*_RADIUS)
            y = side * (sim.scenery_distance + radius + rng.uniform(0.0, _BEHIND))
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                pos=[x, y, low - 0.1 + half],
                size=[radius, half, 0.0],
                **shared,
            )
