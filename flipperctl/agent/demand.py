"""What a training will take of memory, compared with what is free before it starts."""

from __future__ import annotations

import torch

from flipperctl.agent import memory
from flipperctl.agent.building import TRAINED, blamed, build_network
from flipperctl.agent.frames import input_size
from flipperctl.agent.replay import row_bytes
from flipperctl.api import Network, ObservationLayout
from flipperctl.config import Agent

_FLOAT = 4  # bytes


def check_demand(
    network: Network, layout: ObservationLayout, n_actions: int, settings: Agent, decisions: int
) -> None:
    """Refuse a training whose network, replay or batches would not fit into memory.

    ``decisions``: the run's budget; a replay is never filled beyond it.

    Raises:
        ConfigError: the text says how much it would take and what is free.
    """
    with torch.random.fork_rng(devices=[]):
        module = build_network(network, layout, n_actions, copies=TRAINED)
        inputs = input_size(network, layout)
        inside = _numbers_inside(module, inputs)
    rows = min(settings.replay_size, decisions)
    memory.require(
        rows * row_bytes(inputs),
        f"agent.replay_size: {rows:,} transitions of {inputs} numbers each take",
        "keep fewer, or let the network see less",
    )
    together, batch = settings.updates_together, settings.batch_size
    # The transitions of all updates, and what one update keeps for its gradient: every layer's
    # output and the gradient of it.
    numbers = 2 * together * batch * inputs + 2 * batch * inside
    memory.require(
        _FLOAT * numbers,
        f"agent.batch_size: {together} times {batch:,} transitions "
        "(agent.updates_together times it) take",
        "choose smaller ones",
    )


def _numbers_inside(module: torch.nn.Module, inputs: int) -> int:
    """Outputs of all layers for one observation; what is computed between layers is not seen."""
    count = 0

    def add(part: torch.nn.Module, given: object, output: object) -> None:
        nonlocal count
        if isinstance(output, torch.Tensor) and not any(True for _ in part.children()):
            count += output.numel()

    for part in module.modules():  # the module is thrown away after this
        part.register_forward_hook(add)
    try:
        with torch.no_grad():
            module.eval()(torch.zeros(1, inputs))
    except BaseException as error:
        raise blamed(error, module, "forward") from error
    return count
