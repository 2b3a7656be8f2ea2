"""R_end (paper Eq. 7)."""

import numpy as np
from pydantic import Field

from flipperctl.api import FloatArray, Outcome, RewardTerm, Transition, Transitions, reward


@reward("end")
class End(RewardTerm):
    """R_end (paper Eq. 7): +R for reaching the finish, -R for any other end of the episode."""

    settlement: float = Field(10.0, gt=0, le=1e6, description="R; not given in the paper [-]")

    def __call__(self, t: Transition) -> float:
        """Return ±R at the end of the episode, and 0 before."""
        if t.outcome is None:
            return 0.0
        return self.settlement if t.outcome is Outcome.REACHED else -self.settlement

    def array(self, ts: Transitions) -> FloatArray:
        """Return the rewards of M decisions, (M,)."""
        return np.where(ts.reached, self.settlement, -self.settlement * ts.ended)
