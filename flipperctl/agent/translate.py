"""Translation of a torch module to numpy, for workers (``agent.plain``).

In: a module of a network plugin, whatever its package. Out: the calls that compute it in ``eval()``
mode, compared with torch on random observations. A module that does anything beyond the operations
below, or whose Python depends on the numbers, is not translated: torch computes it.
"""

from __future__ import annotations

import copy
import itertools
import operator
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np
import torch
from torch import fx, nn
from torch.nn import functional

from flipperctl.agent import plain
from flipperctl.agent.contract import observations
from flipperctl.agent.networks import NOT_FINITE, Noise, describe_fault, one_thread
from flipperctl.agent.plain import Call, PlainNetwork, PlainNetworks, PlainRisk
from flipperctl.agent.risk import weights_of
from flipperctl.api import Learner, Learning, Network, ObservationLayout

TOLERANCE: Final = 1e-5
"""Largest difference of outputs from torch's, relative to the largest absolute one [-]."""
_ROWS = 64
_ARITHMETIC = [getattr(operator, n) for n in ("add", "sub", "mul", "truediv", "neg", "getitem")]
_FUNCTIONS: Final[Mapping[object, Callable[..., Any]]] = {
    **{function: function for function in _ARITHMETIC},
    torch.cat: plain.cat,
    torch.tanh: np.tanh,
    torch.relu: plain.relu,
    functional.relu: plain.relu,
    functional.leaky_relu: plain.leaky_relu,
    functional.linear: plain.linear,
    # Methods of tensors go by name.
    "mean": plain.mean,
    "tanh": np.tanh,
    "relu": plain.relu,
    "view": plain.reshape,
    "reshape": plain.reshape,
    "flatten": plain.flatten,
    "unsqueeze": np.expand_dims,
}
_LAYERS: Final[Mapping[type[nn.Module], tuple[Callable[..., Any], tuple[str, ...]]]] = {
    nn.Linear: (plain.linear, ("weight", "bias")),
    nn.LeakyReLU: (plain.leaky_relu, ("negative_slope",)),
    nn.ReLU: (plain.relu, ()),
    nn.Tanh: (np.tanh, ()),
    nn.Identity: (plain.identity, ()),
    nn.Dropout: (plain.identity, ()),
    nn.Flatten: (plain.flatten, ("start_dim",)),
    nn.Unflatten: (plain.unflatten, ("dim", "unflattened_size")),
}
"""Function of a layer, and the layer's attributes that it takes after the input."""


def plain_networks(
    agent: Learner, learning: Learning, network: Network, layout: ObservationLayout
) -> PlainNetworks | None:
    """Return what the workers of a training drive with; None if they need torch.

    Noise of a network is drawn by torch.
    """
    if not agent.drives_by_outputs or Noise(learning.driving).parts:
        return None
    if (policy := translated(learning.policy, network, layout)) is None:
        return None
    if (settings := agent.failure_risk) is None:
        return PlainNetworks(policy)
    module: Any = learning.risk
    risk = translated(module.layers, network, layout, "layers.")
    return None if risk is None else PlainNetworks(policy, PlainRisk(risk, settings.horizon))


def translated(
    module: nn.Module, network: Network, layout: ObservationLayout, prefix: str = ""
) -> PlainNetwork | None:
    """Return a module as numpy computes it in ``eval()`` mode; None if only torch can.

    ``network``: the plugin whose input rows it takes. ``prefix``: begins its weights' names.
    """
    fault = describe_fault(module, "forward", NOT_FINITE)
    module = copy.deepcopy(module).cpu().eval().requires_grad_(False)
    weights = {f"{prefix}{name}": array for name, array in weights_of(module).items()}
    try:
        result = _Translation(module, weights, prefix).network(fault)
    except Exception:  # noqa: BLE001 - a plugin's forward may do anything with stand-ins of tensors
        return None
    # The comparison refuses what a trace does not see, such as hooks.
    result.load(weights)
    rows = observations(network, layout, _ROWS)
    with one_thread():
        expected = module(rows).numpy()
    outputs = np.array([result.outputs(row) for row in rows.numpy()])
    close = np.abs(outputs - expected).max() <= TOLERANCE * np.abs(expected).max()
    return replace(result) if close else None  # without the weights


class _Translation:
    """The calls of a traced module; a lookup fails at what only torch can do."""

    def __init__(self, module: nn.Module, weights: Mapping[str, object], prefix: str) -> None:
        self._module, self._names, self._prefix = module, weights, prefix
        self._calls: list[Call] = []
        self._constants: dict[int, Any] = {}
        self._weights: dict[int, str] = {}
        self._places: dict[fx.Node, int] = {}
        self._count = itertools.count(1)  # place 0 is the input
        self._handlers: dict[str, Callable[[fx.Node], int]] = {
            "placeholder": lambda node: 0,
            "get_attr": lambda node: self._weight(node.target),
            "call_module": self._layer,
            "call_function": self._function,
            "call_method": self._function,
            "output": lambda node: self._place(node.args[0]),
        }

    def network(self, fault: str) -> PlainNetwork:
        """Return the network; ``fault``: see ``PlainNetwork``."""
        for node in fx.Tracer().trace(self._module).nodes:
            self._places[node] = self._handlers[node.op](node)
        return PlainNetwork(self._calls, self._constants, self._weights, fault)

    def _function(self, node: fx.Node) -> int:
        function = _FUNCTIONS[node.target]
        if node.kwargs:
            function = partial(function, **{name: _data(v) for name, v in node.kwargs.items()})
        return self._call(function, *map(self._place, node.args))

    def _layer(self, node: fx.Node) -> int:
        layer = self._module.get_submodule(str(node.target))
        function, attributes = _LAYERS[type(layer)]
        values = {f"{node.target}.{name}": getattr(layer, name) for name in attributes}
        more = (
            self._weight(name) if isinstance(value, torch.Tensor) else self._place(value)
            for name, value in values.items()
        )
        return self._call(function, *map(self._place, node.args), *more)

    def _call(self, function: Callable[..., Any], *arguments: int) -> int:
        self._calls.append(Call(function, arguments, place := next(self._count)))
        return place

    def _weight(self, name: Any) -> int:
        if (name := f"{self._prefix}{name}") not in self._names:  # a buffer of no checkpoint
            raise LookupError(name)
        self._weights[place := next(self._count)] = name
        return place

    def _place(self, argument: Any) -> int:
        """Return the place of a result, of a sequence with results in it, or of a constant."""
        if isinstance(argument, fx.Node):
            return self._places[argument]
        if isinstance(argument, list | tuple) and any(isinstance(a, fx.Node) for a in argument):
            return self._call(plain.pack, *map(self._place, argument))
        self._constants[place := next(self._count)] = _data(argument)
        return place


def _data(argument: Any) -> Any:
    """Return a constant without types of torch, which a worker could not unpickle alone."""
    if isinstance(argument, list | tuple):
        data = map(_data, argument)
        return list(data) if isinstance(argument, list) else tuple(data)
    if argument is None or isinstance(argument, int | float | slice):
        return argument
    raise TypeError(argument)
