"""An equal network with fewer layers, for export.

In: a network that may hold modules with a method ``folded``, which returns a faster module with
equal results, or ``folded_into``, which returns a linear layer that replaces the module and the
linear layer after it. Out: a copy of the network with these replacements.
"""

from __future__ import annotations

import copy

from torch import nn


def folded(network: nn.Module) -> nn.Module:
    """Return a copy of ``network`` in evaluation mode, with all foldable modules folded."""
    return _fold(copy.deepcopy(network)).eval()


def _fold(module: nn.Module) -> nn.Module:
    if callable(fold := getattr(module, "folded", None)):
        replacement: nn.Module = fold()
        return replacement
    for name, child in module.named_children():
        setattr(module, name, _fold(child))
    return _join(list(module)) if type(module) is nn.Sequential else module


def _join(parts: list[nn.Module]) -> nn.Module:
    """Return the parts in sequence, each joined to the linear layer after it where possible."""
    for i in reversed(range(len(parts) - 1)):
        join, after = getattr(parts[i], "folded_into", None), parts[i + 1]
        if callable(join) and isinstance(after, nn.Linear):
            parts[i : i + 2] = [join(after)]
    return nn.Sequential(*parts)
