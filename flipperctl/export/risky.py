"""A policy's network and that of its risk as one network, for export.

In: both networks. Out: one with two further outputs; the first one, the Q-values, stays as it is.
"""

from __future__ import annotations

import torch

from flipperctl.agent.risk import Risk


class PolicyWithRisk(torch.nn.Module):
    """Maps inputs (B, F · (N + 3)) to Q-values (B, 9), risks (B, 1), coefficients (B, lags).

    The calibration is folded into the last layer, which becomes two, so that a
    decision computes no product, sum and slices for it.
    """

    def __init__(self, policy: torch.nn.Module, risk: Risk) -> None:
        super().__init__()
        *hidden, last = risk.network.layers
        assert isinstance(last, torch.nn.Linear)
        self.policy, self.hidden = policy, torch.nn.Sequential(*hidden)
        weight, bias = risk.slope * last.weight, risk.slope * last.bias
        self.alone = _layer(weight[:1], bias[:1] + risk.shift)
        self.coefficients = _layer(weight[1:], bias[1:])

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return the Q-values, the risk of the input alone, and what recurrence adds to it."""
        features = self.hidden(observation)
        alone = torch.sigmoid(self.alone(features))
        return self.policy(observation), alone, self.coefficients(features)


def _layer(weight: torch.Tensor, bias: torch.Tensor) -> torch.nn.Linear:
    layer = torch.nn.Linear(weight.shape[1], weight.shape[0])
    layer.load_state_dict({"weight": weight, "bias": bias})
    return layer.requires_grad_(False)


def with_risk(policy: torch.nn.Module, risk: Risk | None) -> torch.nn.Module:
    """Return one network of both, or the policy alone without a risk."""
    return policy if risk is None else PolicyWithRisk(policy, risk).eval()


def output_names(module: torch.nn.Module) -> tuple[str, ...]:
    """Return the names of a network's outputs in an exported file, in their order."""
    if isinstance(module, PolicyWithRisk):
        return ("q_values", "risk", "risk_recurrence")
    return ("q_values",)
