"""How far an evaluation came before it was interrupted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

_SHOWN = 12
"""Largest number of scenes that the sentence names."""


@dataclass(frozen=True)
class Interruption:
    """The finished part of an interrupted evaluation, baselines included."""

    finished: int
    """Number of finished episodes."""
    planned: int
    """Number of episodes that were planned."""
    not_begun: tuple[str, ...]
    """Terrains of the scenes without a finished episode."""

    @property
    def text(self) -> str:
        """One sentence for the user."""
        begun = f"interrupted: {self.finished} of {self.planned} episodes are finished"
        if not self.not_begun:
            return begun
        more = len(self.not_begun) - _SHOWN
        named = ", ".join(self.not_begun[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
        return f"{begun}; not begun: {named}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "interrupted": True,
            "finished_episodes": self.finished,
            "planned_episodes": self.planned,
            "not_begun": list(self.not_begun),
        }
