"""Compares the memory that a training will need with the free memory, before it starts."""

from __future__ import annotations

import torch

from flipperctl.agent import memory
from flipperctl.agent.building import TRAINING_COPIES, build_network, naming_network
from flipperctl.agent.frames import input_size
from flipperctl.agent.replay import row_bytes
from flipperctl.api import Network, ObservationLayout
from flipperctl.config import Agent

_FLOAT = 4  # bytes


def check_demand(
    network: Network,
    layout: ObservationLayout,
    n_actions: int,
    settings: Agent,
    decisions: int,
    *,
    labelled: bool = False,
    privileged: int = 0,
) -> None:
    """Check that the network, the replay and the batches of a training fit into memory.

    ``decisions``: the run's budget, which also limits the transitions in the replay; they have
    labels if the run is ``labelled``, and ``privileged`` numbers of a privileged state.

    Raises:
        ConfigError: they do not fit; the message says how much memory is needed and free.
    """
    with torch.random.fork_rng(devices=[]):
        module = build_network(network, layout, n_actions, copies=TRAINING_COPIES)
        inputs = input_size(network, layout)
        activations = _count_activations(module, inputs)
    rows = min(settings.replay_size, decisions)
    memory.require(
        rows * row_bytes(inputs, n_actions if labelled else 0, privileged, risk=settings.risk),
        f"agent.replay_size: {rows:,} transitions of {inputs} numbers each take",
        "lower it, or use fewer bins or frames",
    )
    together, batch = settings.updates_together, settings.batch_size
    # The transitions of all updates; and for one update the output of every layer and its gradient.
    numbers = 2 * together * batch * inputs + 2 * batch * activations
    memory.require(
        _FLOAT * numbers,
        f"agent.batch_size: {together} times {batch:,} transitions "
        "(agent.updates_together times it) take",
        "lower one of the two",
    )


def _count_activations(module: torch.nn.Module, inputs: int) -> int:
    """Return the number of outputs of all layers without sublayers for one observation [-]."""
    count = 0

    def add(part: torch.nn.Module, inputs: object, output: object) -> None:
        nonlocal count
        if isinstance(output, torch.Tensor) and not any(True for _ in part.children()):
            count += output.numel()

    for part in module.modules():  # the module is discarded after this
        part.register_forward_hook(add)
    with naming_network(module, "forward"), torch.no_grad():
        module.eval()(torch.zeros(1, inputs))
    return count
