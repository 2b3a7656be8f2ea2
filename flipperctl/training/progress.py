"""How far a run is: counters that every part of it reads and that its checkpoint holds."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from flipperctl.checkpoint.document import RECENT


@dataclass
class Progress:
    """The counters of a run."""

    difficulty: float
    """Of the terrain in the next episode that begins or is requested, 0 to 1."""
    decision: int = 0
    """Decisions learnt from so far."""
    episode: int = 0
    """Episodes that ended."""
    started: int = 0
    """Episodes begun or requested; each has a seed of its own."""
    lost: int = 0
    """Episodes whose worker died."""
    updates: int = 0
    loss: float = 0.0
    """Of the last update."""
    recent: deque[bool] = field(default_factory=lambda: deque(maxlen=RECENT))
    """Whether the last episodes reached the finish."""

    @property
    def success_rate(self) -> float:
        """Fraction of the last episodes that reached the finish; 0 before the first."""
        return sum(self.recent) / max(1, len(self.recent))
