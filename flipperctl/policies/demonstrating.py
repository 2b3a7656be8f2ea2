"""A policy that acts as another one and labels every decision.

In: any policy. Out: its actions, each with the label that a student should learn from.
"""

from __future__ import annotations

from flipperctl.api import Perception, Policy, Simulator
from flipperctl.core.risk import RiskSign
from flipperctl.policies import labels
from flipperctl.policies.abilities import RiskPolicy


class DemonstratingPolicy:
    """Acts as its policy; labels each decision by action costs, or by the action without costs."""

    def __init__(self, policy: Policy) -> None:
        self._policy, self._labeller = policy, labels.Labeller(policy)
        self.label = labels.from_action(0)
        """The distribution over actions at the last decision, (9,)."""
        self.groups = None
        self._risks = policy if isinstance(policy, RiskPolicy) else None

    @property
    def risk(self) -> float | None:
        """Risk at the policy's last decision; None if it knows none."""
        return self._risks.risk if self._risks is not None else None

    @property
    def risk_sign(self) -> RiskSign | None:
        """When the policy's risk is a warning; None if it knows none."""
        return self._risks.risk_sign if self._risks is not None else None

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode."""
        self._policy.reset(simulator)

    def act(self, p: Perception) -> int:
        """Return the policy's action, the cheapest if it offers costs; store the label."""
        action, self.label = self._labeller.choose(p)
        self._labeller.took(action)
        return action
