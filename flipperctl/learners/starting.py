"""The weights that a training starts with in place of random ones.

In: a run, a checkpoint or a shipped policy (``agent.start_from``). Out: the networks of the
training with its weights. They may be of a policy that perceives and moves less, see ``widening``.
"""

from __future__ import annotations

from typing import Any

import torch

from flipperctl.agent.networks import build_policy
from flipperctl.agent.risk import RiskNetwork
from flipperctl.api import ObservationLayout
from flipperctl.checkpoint import read
from flipperctl.checkpoint.document import require_equal_layout
from flipperctl.config import TrainConfig
from flipperctl.errors import ConfigError
from flipperctl.learners.pair import NetworkPair
from flipperctl.learners.widening import give_weights, random_rows, seen_by
from flipperctl.policies.source import check_layout, load_policy
from flipperctl.policies.trained import naming, policy_module, policy_risk

SETTING = "agent.start_from"

Start = tuple[torch.nn.Module, torch.nn.Module | None]
"""The networks of a policy and of its risk, if a training takes that."""


def read_start(config: TrainConfig) -> Start | None:
    """Return the networks that a training starts with; None: random ones."""
    settings: Any = config.agent  # of a learner that has the setting
    name: str | None = settings.start_from
    if name is None:
        return None
    file = load_policy(name, SETTING, "checkpoint").file
    # Whatever fails while the file is read, the error names the setting.
    with naming(SETTING):
        checkpoint = read(file)
        module = policy_module(checkpoint)
        layout, wide = checkpoint.policy_config().perception.layout, config.perception.layout
        # A policy without sides does not heed what stands there; one of pairs turns both alike.
        less: dict[str, object] = {"sides": layout.sides or wide.sides}
        if layout.flippers == "pairs":
            less["flippers"] = wide.flippers
        check_layout(file, layout.model_copy(update=less), config.environment())
        risk = policy_risk(checkpoint) if config.agent.failure_risk else None
    network = _same_network(config, name, module, layout)
    if risk is None:
        return network, None
    seen = seen_by(layout, wide, config.network.frames)
    wider = RiskNetwork(len(seen))
    give_weights(risk.network, wider, random_rows(len(seen)), seen)
    return network, wider


def load_start(config: TrainConfig, agent: NetworkPair) -> Start | None:
    """Give the networks of a new training the weights that it starts with, if any; return them."""
    start = read_start(config)
    if start is not None:
        load_start_weights(start, agent)
    return start


def load_start_weights(start: Start, agent: NetworkPair) -> None:
    """Give the networks of ``agent`` the weights that ``read_start`` returned."""
    module, risk = start
    for network in agent.starting:
        network.load_state_dict(module.state_dict())
    if risk is not None and agent.risk is not None:
        agent.risk.network.load_state_dict(risk.state_dict())


def _same_network(
    config: TrainConfig, name: str, module: torch.nn.Module, layout: ObservationLayout
) -> torch.nn.Module:
    """Return the training's network with the weights of ``module``, if both are one function.

    Settings that only change how it learns, such as a dropout, and names of weights may differ.
    ``layout``: what ``module`` perceives, all of which the training perceives, too.
    """
    text = (
        f"{SETTING}: {name} has another network than this training; give it the same network and "
        "settings of the network"
    )
    wide = config.perception.layout
    built = build_policy(config.network, wide).eval()
    seen = seen_by(layout, wide, config.network.frames)
    rows, outputs, branches = random_rows(len(seen)), built, None
    if len(wide.joints) != len(layout.joints):
        branches = torch.eye(3 ** len(layout.joints)).repeat(2, 1)  # each side as the pairs
        outputs = built.get_submodule("branches")
    try:
        if layout == wide:
            _require_equal_shapes(module, built)
        give_weights(module, outputs, rows, seen, branches)
        # Equal shapes do not make equal functions: values of random inputs are compared as well.
        with torch.inference_mode():
            wanted = module(rows @ seen)
            wanted = wanted if branches is None else wanted @ branches.T
            equal = torch.allclose(outputs(rows), wanted, rtol=1e-4, atol=1e-4)
    except (ValueError, RuntimeError) as error:
        raise ConfigError(f"{text} ({str(error).splitlines()[0]})") from error
    if not equal:
        raise ConfigError(text)
    return built


def _require_equal_shapes(module: torch.nn.Module, built: torch.nn.Module) -> None:
    """Name the first weight whose shape differs."""
    weights, initial = module.state_dict(), built.state_dict()
    if [w.shape for w in weights.values()] != [w.shape for w in initial.values()]:
        require_equal_layout(weights, initial)
