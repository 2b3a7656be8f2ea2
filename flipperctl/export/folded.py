"""The same network with fewer layers, as it is exported.

In: a network that may hold modules with a method ``folded``, which returns a module of equal
results that takes less time, or ``folded_into``, which returns a linear layer that does what the
module and the linear layer after it do. Out: a copy of the network with those in their places.
"""

from __future__ import annotations

import copy

from torch import nn


def folded(network: nn.Module) -> nn.Module:
    """Return a copy of ``network`` in evaluation mode, in which each module that can is folded."""
    return _fold(copy.deepcopy(network)).eval()


def _fold(module: nn.Module) -> nn.Module:
    if callable(fold := getattr(module, "folded", None)):
        replacement: nn.Module = fold()
        return replacement
    for name, child in module.named_children():
        setattr(module, name, _fold(child))
    return _join(list(module)) if type(module) is nn.Sequential else module


def _join(parts: list[nn.Module]) -> nn.Module:
    """Return the parts in a row, each that can joined with the linear layer after it."""
    for i in reversed(range(len(parts) - 1)):
        join, after = getattr(parts[i], "folded_into", None), parts[i + 1]
        if callable(join) and isinstance(after, nn.Linear):
            parts[i : i + 2] = [join(after)]
    return nn.Sequential(*parts)
