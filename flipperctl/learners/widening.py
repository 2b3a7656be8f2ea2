"""A network that perceives or moves more than another, and begins as the same function.

In: a network, and one of its kind for an observation with both sides, or for four flippers in place
of pairs. Out: the second with the first one's weights. What it alone perceives counts nothing until
it learns. The flippers of a pair are sensed by their mean, and both turn as the pair did.
"""

from __future__ import annotations

import torch

from flipperctl.api import ObservationLayout


def seen_by(layout: ObservationLayout, wide: ObservationLayout, frames: int) -> torch.Tensor:
    """Return the matrix S by which input rows of ``wide`` @ S are those of ``layout``.

    Its shape is (F · m, F · n) for observations of m and n numbers. Sides stand between an
    observation's heights and the angles of its joints, which end before the pitch.
    """
    single = torch.zeros(wide.size, layout.size)
    for place in range(layout.heights):
        single[place, place] = 1.0
    # Angle of a pair: the mean of its flippers
    each = len(wide.joints) // len(layout.joints)
    for joint in range(len(layout.joints)):
        first = wide.size - 1 - len(wide.joints) + joint * each
        single[first : first + each, layout.size - 1 - len(layout.joints) + joint] = 1 / each
    single[-1, -1] = 1.0
    return torch.kron(torch.eye(frames), single)


def random_rows(size: int) -> torch.Tensor:
    """Return random input rows, more than a layer has inputs, the same at each call, (R, size)."""
    return torch.randn((2 * size, size), generator=torch.Generator().manual_seed(0))


@torch.no_grad()
def give_weights(
    module: torch.nn.Module,
    built: torch.nn.Module,
    rows: torch.Tensor,
    seen: torch.Tensor,
    branches: torch.Tensor | None = None,
) -> None:
    """Give ``built`` the weights of ``module``; inputs that it alone has are weighted by 0.

    ``rows`` are input rows of ``built``, (R, F · m); ``rows @ seen`` are those of ``module``, and
    the outputs of ``built`` shall be ``branches`` of those of ``module``, or the same. Whether they
    are is for the caller to compare.

    Raises:
        ValueError, RuntimeError: they differ by more than the inputs and outputs of linear layers.
    """
    # Weights are matched in their order, since a version may have renamed them.
    weights, initial = module.state_dict().values(), built.state_dict().values()
    for source, target in zip(weights, initial, strict=True):
        if source.shape == target.shape:
            target.copy_(source)
    for layer, wider in zip(_linear(module), _linear(built), strict=True):
        weight: torch.Tensor = layer.weight
        bias: torch.Tensor | None = layer.bias
        if branches is not None and layer.out_features != wider.out_features:
            weight, bias = branches @ weight, branches @ layer.bias
        # A layer that sees more gets the weights by which it answers alike, first layers first. The
        # smallest ones are taken: what it alone sees has none.
        if layer.in_features != wider.in_features:
            answers = _reaching(module, layer, rows @ seen).double() @ weight.T.double()
            reaching = _reaching(built, wider, rows).double()
            weight = torch.linalg.lstsq(reaching, answers, driver="gelsy").solution.T
        wider.weight.copy_(weight)
        if bias is not None:
            wider.bias.copy_(bias)


def _linear(module: torch.nn.Module) -> list[torch.nn.Linear]:
    return [layer for layer in module.modules() if isinstance(layer, torch.nn.Linear)]


def _reaching(module: torch.nn.Module, layer: torch.nn.Linear, rows: torch.Tensor) -> torch.Tensor:
    """Return the inputs of a layer of ``module`` for input rows, (R, inputs)."""
    inputs: list[torch.Tensor] = []
    hook = layer.register_forward_pre_hook(lambda _, arguments: inputs.append(arguments[0]))
    module(rows)
    hook.remove()
    return inputs[0]
