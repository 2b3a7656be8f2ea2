"""How an episode ends: reached, overturned, stuck or timeout.

In: where the robot is, sample by sample and after each decision. Out: the outcome, or None.
"""

from __future__ import annotations

import math
from collections import deque

from flipperctl.api import Limits, Outcome, Profile, Robot, World
from flipperctl.config import Episode


class Ends:
    """Ends one episode: ``instant`` within a decision, ``decision`` after one that ended nothing.

    The world stops at the first sample that reaches ``limits``; ``instant`` says which end it is.
    """

    def __init__(
        self, profile: Profile, robot: Robot, episode: Episode, start: float, period: float
    ) -> None:
        """``start``: x of the chassis centre [m]; ``period``: of the decisions [s]."""
        self._episode = episode
        self.finish = profile.end + episode.run_out
        # Past the profile the ground is level, so that one height tells who is close to it.
        top = profile.height(self.finish) + robot.track_radius + episode.clearance
        self.limits = Limits(episode.overturn, self.finish, top, robot.hinge_offset)
        nominal = (self.finish - start) / robot.track_speed  # [s]
        self.t_max = math.ceil(episode.slack * nominal / period)
        self._trail: deque[float] = deque([start], maxlen=episode.stuck_window + 1)
        self._decisions = 0

    def instant(self, world: World) -> Outcome | None:
        """Overturned, or past the finish with the chassis' higher end close to the ground."""
        limits = self.limits
        if abs(world.pitch) >= limits.angle:
            return Outcome.OVERTURNED
        x, z = world.position
        close = z + limits.half * abs(math.sin(world.pitch)) <= limits.top
        return Outcome.REACHED if x >= limits.x and close else None

    def decision(self, x: float) -> Outcome | None:
        """Too little progress over the window, or out of decisions."""
        self._decisions += 1
        self._trail.append(x)
        full = len(self._trail) == self._trail.maxlen
        if full and x < self.finish and x - self._trail[0] < self._episode.stuck_progress:
            return Outcome.STUCK
        return Outcome.TIMEOUT if self._decisions >= self.t_max else None

    def save(self) -> tuple[tuple[float, ...], int]:
        """What changes from decision to decision."""
        return tuple(self._trail), self._decisions

    def load(self, saved: tuple[tuple[float, ...], int]) -> None:
        """Go back to what ``save`` gave."""
        trail, self._decisions = saved
        self._trail = deque(trail, maxlen=self._trail.maxlen)
