"""A policy's network and that of its risk as one network, for export.

In: both networks. Out: one with two further outputs; the first one, the Q-values, stays as it is.
"""

from __future__ import annotations

import torch

from flipperctl.agent.risk import Risk


class PolicyWithRisk(torch.nn.Module):
    """Maps inputs (B, F · (N + 3)) to Q-values (B, 9), risks (B, 1), coefficients (B, lags)."""

    def __init__(self, policy: torch.nn.Module, risk: Risk) -> None:
        super().__init__()
        self.policy, self.risk = policy, risk

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return the Q-values, the risk of the input alone, and what recurrence adds to it."""
        return self.policy(observation), *self.risk(observation)


def with_risk(policy: torch.nn.Module, risk: Risk | None) -> torch.nn.Module:
    """Return one network of both, or the policy alone without a risk."""
    return policy if risk is None else PolicyWithRisk(policy, risk).eval()


def output_names(module: torch.nn.Module) -> tuple[str, ...]:
    """Return the names of a network's outputs in an exported file, in their order."""
    if isinstance(module, PolicyWithRisk):
        return ("q_values", "risk", "risk_recurrence")
    return ("q_values",)
