"""One instant of an episode, with all that a picture of it needs."""

from __future__ import annotations

from dataclasses import dataclass

from flipperctl.api import Outcome, Perception, Profile, RobotState


@dataclass(frozen=True)
class Scene:
    """What there is to see."""

    terrain: str
    profile: Profile
    start: float
    """x of the chassis centre at the start, without its noise [m]."""
    finish: float
    """x that the chassis centre must pass [m]."""
    track_speed: float
    """[m/s]"""
    state: RobotState
    perception: Perception
    action: tuple[int, int] | None = None
    """The (front, rear) that led here."""
    outcome: Outcome | None = None
