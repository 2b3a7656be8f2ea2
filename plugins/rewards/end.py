"""R_end (paper Eq. 7)."""

from pydantic import Field

from flipperctl.api import Outcome, RewardTerm, Transition, reward


@reward("end")
class End(RewardTerm):
    """R_end (paper Eq. 7): the settlement, +R when the finish is reached, else -R."""

    settlement: float = Field(10.0, gt=0, le=1e6, description="R; paper silent [-]")

    def __call__(self, t: Transition) -> float:
        """0 while the episode runs."""
        if t.outcome is None:
            return 0.0
        return self.settlement if t.outcome is Outcome.REACHED else -self.settlement
