"""One instant of an episode, with everything that a picture of it needs."""

from __future__ import annotations

from dataclasses import dataclass

from flipperctl.api import Outcome, Perception, Profile, RobotState

WIDTH, HEIGHT = 960, 480
"""Width and height of a picture [px]."""


@dataclass(frozen=True)
class Scene:
    """One instant of an episode."""

    terrain: str
    """Registered name of the terrain."""
    profile: Profile
    start: float
    """World x of the chassis centre at the start, without the drawn shift [m]."""
    finish: float
    """World x that the chassis centre must pass [m]."""
    track_speed: float
    """Speed of the belts [m/s]."""
    state: RobotState
    perception: Perception
    action: tuple[int, int] | None = None
    """Last action (front, rear); None before the first."""
    outcome: Outcome | None = None
    """How the episode ended; None while it runs."""
