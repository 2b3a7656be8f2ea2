"""Where an episode starts and finishes, and one instant of it as plain data.

In: a profile, the sampled robot, the settings of the episode and a generator. Out: the start, which
the engine places; the finish, past the last edge on level ground or on the obstacle itself.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from flipperctl.api import Profile, Robot, Start, World
from flipperctl.config import EnvConfig, Episode
from flipperctl.errors import ConfigError, TerrainError
from flipperctl.sim.ground import OVERLAP, resting

_STRIDE = 0.05
"""Distance between two places that are tried [m]."""
_STEEPEST = math.pi / 4
"""Largest absolute pitch of a robot at a place that the ground chooses [rad]."""

Pose = tuple[float, float]
"""World z [m] and pitch [rad] of the chassis."""


def nearest_rest(
    profile: Profile, robot: Robot, x: float, flippers: tuple[float, float], overturn: float
) -> tuple[float, Pose | None]:
    """Return the place on the obstacle nearest to ``x`` [m] where the robot stands, and its pose.

    ``flippers`` are the angles (front, rear) in frame R [rad]; the pitch is below ``overturn``
    [rad] and at most 45°. The pose is None if there is no such place.
    """
    farthest = max(x - profile.start, profile.end - x)
    for step in range(math.ceil(farthest / _STRIDE) + 1):
        # Ahead and behind in turn; a dict keeps their order and drops an equal place.
        for place in {x + step * _STRIDE: None, x - step * _STRIDE: None}:
            if profile.start <= place <= profile.end:
                pose = resting(profile, robot, place, *flippers, min(overturn, _STEEPEST))
                if pose is not None:
                    return place, pose
    return x, None


class Finish(NamedTuple):
    """The finish of an episode, with the fields of ``flipperctl.api.Limits``."""

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
    """Return the finish: the last edge + ``run_out`` of the profile, or else of the episode.

    Past the last edge the ground is level. With ``run_out`` below 0 the finish lies on the
    obstacle. The highest end of the chassis is then compared with that of a robot that stands there
    with level flippers. Farther on the limit is a line parallel to its chassis, down to the level
    ground past the last edge. Past that edge the robot also finishes on level ground above the
    line: it drives on if it passed the finish on raised flippers and the ground then rises.
    """
    run_out = run_out_of(profile, episode)
    x = profile.end + run_out
    level = float(profile.points[-1, 1]) + robot.track_radius + episode.clearance
    if run_out >= 0:
        return Finish(x, level)
    # On the obstacle a robot must be able to stand, with level flippers.
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


_TURNED, _LIFTED = 0.1, 0.15
"""Largest differences of an engine's start from the given one: pitch [rad] and height [m]. A steep
pitch may be half of that: an engine that starts level misses all of it, and a heading in 3-D up to
a quarter. Rough ground in 3-D lifts the robot."""


def sampled(
    profile: Profile, robot: Robot, episode: Episode, rng: np.random.Generator
) -> tuple[Start, dict[str, float]]:
    """Return the start, and what was drawn for it, by name.

    Ahead of the first edge the robot rests level; past it (``run_up`` below 0) it has the height
    and the pitch in which it rests there. A profile's own ``run_up`` chooses the place, or the
    nearest one where the robot can stand.
    """
    # Always three draws, so that the size of the noise changes no later draw.
    shift, *turned = rng.uniform(-1.0, 1.0, 3) * np.array(
        [episode.start_noise, episode.start_angle_noise, episode.start_angle_noise]
    )
    run_up = run_up_of(profile, episode)
    x = profile.start - run_up + shift
    front, rear = (robot.clip(episode.start_angle + angle) for angle in turned)
    drawn = {"start_shift": shift, "start_front": front, "start_rear": rear}
    if run_up >= 0:
        return Start(x, front=front, rear=rear), drawn
    # Past the first edge the ground gives height and pitch.
    finish = profile.end + run_out_of(profile, episode)
    if x >= finish:
        raise TerrainError(
            f"episode.run_up: {run_up:g} m starts past the finish of {profile.label!r}, "
            f"which is {finish - profile.start:.2f} m from its first edge"
        )
    if profile.run_up is None:
        pose = resting(profile, robot, x, front, rear, episode.overturn)
    else:
        x, pose = nearest_rest(profile, robot, x, (front, rear), episode.overturn)
    if pose is None:
        raise TerrainError(
            f"episode.run_up: the robot cannot stand {x - profile.start:.2f} m past the first edge "
            f"of {profile.label!r} with a pitch below episode.overturn; start elsewhere"
        )
    height, pitch = pose
    return Start(x, front=front, rear=rear, height=height, pitch=pitch), drawn


def run_up_of(profile: Profile, episode: Episode) -> float:
    """Return the distance of the start before the first edge, without the random shift [m]."""
    return episode.run_up if profile.run_up is None else profile.run_up


def is_lifted(world: World, start: Start) -> bool:
    """Return whether the engine placed the robot far above a start past the first edge.

    In 3-D it does so where the ground beside the profile is far above it.
    """
    return start.height is not None and world.position[1] - start.height > _LIFTED


def ahead(profile: Profile) -> Profile:
    """Return a profile that chose its start without that choice, to start before its first edge.

    What it drew for it, which is called ``start_on``, is left out.
    """
    drawn = {name: value for name, value in profile.drawn.items() if name != "start_on"}
    return replace(profile, run_up=None, drawn=drawn)


def check_placed(world: World, start: Start, config: EnvConfig, profile: Profile) -> None:
    """Check that the engine placed the robot on the ground, where it should start."""
    run_up = run_up_of(profile, config.episode)
    # An engine that starts on level ground alone shows in the pose.
    if start.height is not None:
        turned, lifted = world.pitch - start.pitch, world.position[1] - start.height
        if abs(turned) > max(_TURNED, abs(start.pitch) / 2) or abs(lifted) > _LIFTED:
            raise ConfigError(
                f"episode.run_up: {run_up:g} m starts past the first edge, where "
                f"sim={config.sim.plugin_name} does not place the robot along the ground; 0 m or "
                "more is allowed"
            )
    if (depth := world.penetration()) > OVERLAP:
        raise TerrainError(
            f"terrain {config.terrain.plugin_name!r} overlaps the robot at the start by "
            f"{depth:.3f} m, with the chassis centre {abs(run_up):g} m "
            f"{'before' if run_up >= 0 else 'past'} the first edge"
        )
