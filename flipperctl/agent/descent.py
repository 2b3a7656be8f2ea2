"""Steps of an optimiser on the parameters of networks, which lie in one vector.

In: networks, losses, and a checkpoint's tensors by name. Out: changed parameters and moments.

Adam is that of Kingma & Ba 2015, Algorithm 1. torch's own optimiser computes the same, but
constructing one imports torch's compiler (``torch._dynamo``, as of torch 2.13), which costs a
second and 80 MB.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

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


def flatten_parameters(modules: Sequence[torch.nn.Module]) -> torch.Tensor:
    """Move the modules' parameters into one vector, (P,); they become views of it."""
    parameters = [p for module in modules for p in module.parameters()]
    vector = torch.cat([p.detach().reshape(-1) for p in parameters])
    parts = torch.split(vector, [p.numel() for p in parameters])
    for parameter, part in zip(parameters, parts, strict=True):
        parameter.data = part.view_as(parameter)
    return vector


def descend(
    loss: torch.Tensor,
    parameters: Sequence[torch.Tensor],
    optimiser: Adam,
    norm: float,
    rate: float,
) -> None:
    """Take one step of the optimiser against the gradient of the loss, clipped to ``norm``.

    Parameters without a part in the loss, such as those of noise that is off, have a gradient of 0.
    """
    gradients = torch.autograd.grad(loss, parameters, allow_unused=True, materialize_grads=True)
    with torch.no_grad():
        gradient = torch.cat([g.reshape(-1) for g in gradients])
        length = float(torch.linalg.vector_norm(gradient))
        if length > norm:
            gradient.mul_(norm / length)
        optimiser.step(gradient, rate)


def part(tensors: Mapping[str, torch.Tensor], name: str) -> dict[str, torch.Tensor]:
    """Return the tensors whose names begin with a part's name, without it."""
    start = f"{name}."
    return {key.removeprefix(start): t for key, t in tensors.items() if key.startswith(start)}


def restore_moments(optimiser: Adam, moments: Mapping[str, torch.Tensor], steps: int) -> None:
    """Give an optimiser its moments after ``steps`` gradient steps."""
    for name, moment in optimiser.moments.items():
        moment.copy_(moments[name])
    optimiser.steps = steps
