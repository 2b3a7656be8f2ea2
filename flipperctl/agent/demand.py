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
) -> None:
    """Refuse a training whose network, replay or batches would not fit into memory.

    ``decisions``: the run's budget, which also limits the transitions in the replay, each of which
    has a label if the run is ``labelled``.

    Raises:
        ConfigError: the memory does not suffice; the text says how much is needed and free.
    """
    with torch.random.fork_rng(devices=[]):
        module = build_network(network, layout, n_actions, copies=TRAINING_COPIES)
        inputs = input_size(network, layout)
        inside = _numbers_inside(module, inputs)
    rows = min(settings.replay_size, decisions)
    memory.require(
        rows * row_bytes(inputs, n_actions if labelled else 0),
        f"agent.replay_size: {rows:,} transitions of {inputs} numbers each take",
        "keep fewer, or let the network see less",
    )
    together, batch = settings.updates_together, settings.batch_size
    # The transitions of all updates, and the numbers that one update keeps for its gradient: the
    # output of every layer and its gradient.
    numbers = 2 * together * batch * inputs + 2 * batch * inside
    memory.require(
        _FLOAT * numbers,
        f"agent.batch_size: {together} times {batch:,} transitions "
        "(agent.updates_together times it) take",
        "choose smaller ones",
    )


def _numbers_inside(module: torch.nn.Module, inputs: int) -> int:
    """Count the outputs of all layers for one observation, not those between layers [-]."""
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
