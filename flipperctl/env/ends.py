"""Ends of an episode (design: reached, overturned, stuck, timeout)."""

from __future__ import annotations

import math
from collections import deque

from flipperctl.api import Outcome, Profile
from flipperctl.config import Episode, Robot
from flipperctl.sim.world import World


class Ends:
    """Judges one episode: ``instant`` wherever a limit may be reached, ``decision`` after each."""

    def __init__(self, profile: Profile, robot: Robot, episode: Episode, start: float) -> None:
        """``start``: x of the chassis centre [m]."""
        self._episode = episode
        self._robot = robot
        self._profile = profile
        self.finish = profile.end + episode.run_out
        nominal = (self.finish - start) / robot.track_speed  # [s]
        self.t_max = math.ceil(episode.slack * nominal / robot.decision_period)
        self._trail: deque[float] = deque([start], maxlen=episode.stuck_window + 1)
        self._decisions = 0

    def instant(self, world: World) -> Outcome | None:
        """Overturned, or behind the finish with the whole chassis close to the ground."""
        pitch = world.pitch
        if abs(pitch) >= self._episode.overturn:
            return Outcome.OVERTURNED
        x, z = world.position
        if x < self.finish:
            return None
        highest = z + self._robot.hinge_offset * abs(math.sin(pitch)) - self._robot.track_radius
        close = highest - self._profile.height(x) <= self._episode.clearance
        return Outcome.REACHED if close else None

    def decision(self, x: float) -> Outcome | None:
        """Too little progress over the window, or out of decisions."""
        self._decisions += 1
        self._trail.append(x)
        full = len(self._trail) == self._trail.maxlen
        if full and x < self.finish and x - self._trail[0] < self._episode.stuck_progress:
            return Outcome.STUCK
        return Outcome.TIMEOUT if self._decisions >= self.t_max else None
