"""A network that perceives more than another, and begins as the same function.

In: a network, and one of its kind whose input rows have further numbers. Out: the second with the
first one's weights. What it alone perceives counts nothing until it learns.
"""

from __future__ import annotations

import torch

from flipperctl.api import ObservationLayout


def columns(layout: ObservationLayout, wide: ObservationLayout, frames: int) -> torch.Tensor:
    """Return where the numbers of an input row of ``layout`` stand in one of ``wide``, (F · n,).

    Sides stand between an observation's heights and its angles.
    """
    angles = layout.size - layout.heights
    one = torch.cat([torch.arange(layout.heights), torch.arange(wide.size - angles, wide.size)])
    return torch.cat([frame * wide.size + one for frame in range(frames)])


def random_rows(size: int) -> torch.Tensor:
    """Return random input rows, more than a layer has inputs, the same at each call, (R, size)."""
    return torch.randn((2 * size, size), generator=torch.Generator().manual_seed(0))


@torch.no_grad()
def give_weights(
    module: torch.nn.Module, built: torch.nn.Module, rows: torch.Tensor, columns: torch.Tensor
) -> None:
    """Give ``built`` the weights of ``module``; inputs that it alone has are weighted by 0.

    ``rows`` are input rows of ``built``, (R, F · m); ``columns``, (F · n,), are those that
    ``module`` sees. Whether both are one function afterwards is for the caller to compare.

    Raises:
        ValueError, RuntimeError: they differ by more than the inputs of linear layers.
    """
    # Weights are matched in their order, since a version may have renamed them.
    weights, initial = module.state_dict().values(), built.state_dict().values()
    for source, target in zip(weights, initial, strict=True):
        if source.shape == target.shape:
            target.copy_(source)
    # A layer that sees more gets the weights by which it answers alike, first layers first. The
    # smallest ones are taken: what it alone sees has none.
    for layer, wider in zip(_linear(module), _linear(built), strict=True):
        if layer.in_features != wider.in_features:
            seen, wanted = _reaching(built, wider, rows), _reaching(module, layer, rows[:, columns])
            answers = wanted.double() @ layer.weight.T.double()
            solved = torch.linalg.lstsq(seen.double(), answers, driver="gelsy")
            wider.weight.copy_(solved.solution.T)


def _linear(module: torch.nn.Module) -> list[torch.nn.Linear]:
    return [layer for layer in module.modules() if isinstance(layer, torch.nn.Linear)]


def _reaching(module: torch.nn.Module, layer: torch.nn.Linear, rows: torch.Tensor) -> torch.Tensor:
    """Return the inputs of a layer of ``module`` for input rows, (R, inputs)."""
    inputs: list[torch.Tensor] = []
    hook = layer.register_forward_pre_hook(lambda _, arguments: inputs.append(arguments[0]))
    module(rows)
    hook.remove()
    return inputs[0]
