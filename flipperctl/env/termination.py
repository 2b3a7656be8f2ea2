"""Determines how an episode ends: reached, overturned, stuck or timeout.

In: the robot's pose at each sample and after each decision. Out: the outcome, or None.
"""

from __future__ import annotations

import math
from collections import deque

from flipperctl.api import Limits, Outcome, Profile, Robot
from flipperctl.config import Episode
from flipperctl.env.start import finish_of
from flipperctl.errors import ConfigError, TerrainError


class Termination:
    """The termination of one episode.

    The world stops at the first sample that reaches ``limits``; ``after_sample`` then returns the
    outcome. ``after_decision`` is called after each decision without an outcome.
    """

    def __init__(
        self, profile: Profile, robot: Robot, episode: Episode, start: float, period: float
    ) -> None:
        """Begin at ``start``, world x of the chassis centre [m]; decisions take ``period`` [s]."""
        self._episode = episode
        finish = finish_of(profile, robot, episode)
        self.finish = finish.x
        if start >= finish.x:
            raise TerrainError(
                f"episode.run_out: the finish of {profile.label!r} lies "
                f"{start - finish.x:.2f} m behind the start; start or finish elsewhere"
            )
        self.limits = Limits(angle=episode.overturn, half=robot.hinge_offset, **finish._asdict())
        # The longest episode: the time at full speed, times the slack.
        nominal = float(self.finish - start) / robot.track_speed  # [s]
        longest = episode.slack * nominal / period
        if not math.isfinite(longest):
            raise ConfigError(
                f"robot.track_speed: at {robot.track_speed:g} m/s the distance of "
                f"{self.finish - start:g} m does not take a finite number of decisions"
            )
        self.t_max = math.ceil(longest)
        # The window of being stuck: its decisions and the position before them.
        self._trail: deque[float] = deque([start], maxlen=episode.stuck_decisions(period) + 1)
        self._decisions = 0

    def after_sample(self, x: float, z: float, pitch: float) -> Outcome | None:
        """Return OVERTURNED, or REACHED past the finish with both ends close to the ground."""
        if not self.limits.reached(x, z, pitch):
            return None
        over = abs(pitch) >= self.limits.angle
        return Outcome.OVERTURNED if over else Outcome.REACHED

    def after_decision(self, x: float, driven: bool = True) -> Outcome | None:
        """Return STUCK after too little progress, or TIMEOUT after the last allowed decision.

        ``x``: world x of the chassis centre [m]; ``driven``: whether the belts ran ahead, and not
        stood or ran back as an operator wanted.
        """
        self._decisions += 1
        # Belts that stood or ran back are no standstill: the window begins anew.
        if not driven:
            self._trail.clear()
        self._trail.append(x)
        full = len(self._trail) == self._trail.maxlen
        if full and x < self.finish and x - self._trail[0] < self._episode.stuck_progress:
            return Outcome.STUCK
        return Outcome.TIMEOUT if self._decisions >= self.t_max else None

    def save(self) -> tuple[tuple[float, ...], int]:
        """Return a snapshot of the changing state for ``load``."""
        return tuple(self._trail), self._decisions

    def load(self, saved: tuple[tuple[float, ...], int]) -> None:
        """Restore a snapshot."""
        trail, self._decisions = saved
        self._trail = deque(trail, maxlen=self._trail.maxlen)
