"""Where an episode finishes: past the last edge on level ground, or on the obstacle itself.

In: a profile, the sampled robot and the settings of the episode. Out: the place of the finish, and
how high the chassis may be there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flipperctl.api import Profile, Robot
from flipperctl.config import Episode
from flipperctl.env.places import nearest_rest
from flipperctl.errors import TerrainError
from flipperctl.sim.resting import resting


class Finish(NamedTuple):
    """The finish of an episode; its fields are those of ``flipperctl.api.Limits``."""

    x: float
    """World x that the chassis centre must pass [m]."""
    top: float
    """Largest world z of the higher end of the chassis there [m]."""
    slope: float = 0.0
    """Rise of that height for each metre past the finish [-]."""
    end: float = math.inf
    """World x of the last edge, past which the ground is level [m]."""
    level: float = -math.inf
    """Largest world z of the higher end on that level ground [m]."""


def run_out_of(profile: Profile, episode: Episode) -> float:
    """Return the distance of the finish past the last edge [m]."""
    return episode.run_out if profile.run_out is None else profile.run_out


def finish_of(profile: Profile, robot: Robot, episode: Episode) -> Finish:
    """Return the finish, of which ``run_out`` of the profile or else of the episode decides.

    Past the last edge the ground is level. Short of it (``run_out`` below 0), the highest end of
    the chassis is compared with that of a robot that stands there with level flippers, and farther
    on with a line that is parallel to its chassis, down to the level ground past the last edge.
    Past that edge the robot has finished on the level ground, too, where that lies above the line:
    one that passed the finish on raised flippers, as it may where the ground then rises, drives on.

    Raises:
        TerrainError: the robot cannot stand at the finish.
    """
    run_out = run_out_of(profile, episode)
    x = profile.end + run_out
    level = float(profile.points[-1, 1]) + robot.track_radius + episode.clearance
    if run_out >= 0:
        return Finish(x, level)
    if profile.run_out is None:
        pose = resting(profile, robot, x, 0.0, 0.0, episode.overturn)
    else:
        x, pose = nearest_rest(profile, robot, x, (0.0, 0.0), episode.overturn)
    if pose is None:
        raise TerrainError(
            f"episode.run_out: the robot cannot stand {-run_out:.2f} m before the last edge of "
            f"{profile.label!r} with a pitch below episode.overturn; finish elsewhere"
        )
    height, pitch = pose
    top = height + robot.hinge_offset * abs(math.sin(pitch)) + episode.clearance
    return Finish(x, top, math.tan(pitch), profile.end, level)
