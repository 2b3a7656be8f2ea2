"""The progress of a run: counters that its parts share and its checkpoint stores."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from flipperctl.checkpoint.document import RECENT


@dataclass
class Progress:
    """The counters of a run."""

    difficulty: float
    """Difficulty of the terrain in the next new or requested episode, 0 to 1."""
    decision: int = 0
    """Number of decisions stored for learning so far."""
    episode: int = 0
    """Number of episodes that ended."""
    started: int = 0
    """Number of episodes begun or requested; each has its own seed."""
    lost: int = 0
    """Number of episodes lost because their worker died."""
    updates: int = 0
    """Number of updates of the network."""
    loss: float = 0.0
    """Loss of the last update."""
    recent: deque[bool] = field(default_factory=lambda: deque(maxlen=RECENT))
    """Whether the last episodes reached the finish."""

    @property
    def success_rate(self) -> float:
        """Fraction of the last episodes that reached the finish; 0 before the first."""
        return sum(self.recent) / max(1, len(self.recent))
