"""Adam on one vector of parameters (Kingma & Ba 2015, Algorithm 1).

torch's own optimiser computes the same, but constructing one imports torch's compiler
(``torch._dynamo``, as of torch 2.13), which costs a second and 80 MB.
"""

from __future__ import annotations

import math

import torch

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8
"""The paper's decay rates of the moments, and its term against a division by zero [-]."""


class Adam:
    """Holds the moments of the gradient and changes ``parameters`` in place."""

    def __init__(self, parameters: torch.Tensor) -> None:
        """Optimise ``parameters``, (P,)."""
        self.parameters = parameters
        self.moments = {name: torch.zeros_like(parameters) for name in ("first", "second")}
        self.steps = 0

    def step(self, gradient: torch.Tensor, rate: float) -> None:
        """Take one step against ``gradient``, (P,), with the learning rate ``rate``."""
        self.steps += 1
        first, second = self.moments["first"], self.moments["second"]
        first.lerp_(gradient, 1 - BETA_1)
        second.mul_(BETA_2).addcmul_(gradient, gradient, value=1 - BETA_2)
        scale = math.sqrt(1 - BETA_2**self.steps)  # this and the next line: bias corrections
        size = rate * scale / (1 - BETA_1**self.steps)
        self.parameters.addcdiv_(first, second.sqrt().add_(EPSILON * scale), value=-size)
