"""The weights that a training starts with in place of random ones, and the last part of it.

In: a run, a checkpoint or a shipped policy (``agent.start_from``). Out: its networks' weights in
those of the training, and on request those of its values. ``FinalFit`` begins with them again.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from flipperctl.agent.d3qn import D3qn
from flipperctl.agent.frames import input_size
from flipperctl.agent.learner import Learner, join
from flipperctl.agent.networks import build_network
from flipperctl.agent.policy_gradient import PolicyGradient, build_values
from flipperctl.agent.replay import Replay
from flipperctl.api import ACTIONS, ObservationLayout
from flipperctl.checkpoint import LAST, Checkpoint, find, read
from flipperctl.checkpoint.document import require_equal_layout
from flipperctl.config import TrainConfig, to_dict
from flipperctl.config.identity import differences
from flipperctl.env.privileged import SIZE
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.policies.source import check_layout, load_policy
from flipperctl.policies.trained import naming, policy_module, policy_risk

_SETTING = "agent.start_from"
_VALUES = "agent.policy_gradient.start_values"
_ROWS = 64
"""Random inputs on which the two networks must agree [-]."""


Start = tuple[torch.nn.Module, torch.nn.Module | None]
"""The networks of a policy and of its risk, if a training takes that."""


def read_start(config: TrainConfig) -> Start | None:
    """Return the networks that a training starts with; None: random ones."""
    name = config.agent.start_from
    if name is None:
        return None
    file = load_policy(name, _SETTING, "checkpoint").file
    with naming(_SETTING):
        checkpoint = read(file)
        module = policy_module(checkpoint)
        theirs = checkpoint.policy_config().perception.layout
        check_layout(file, theirs, config.environment())
        risk = policy_risk(checkpoint) if config.agent.risk else None
    return _same_network(config, name, module), None if risk is None else risk.network


def read_values(config: TrainConfig) -> dict[str, torch.Tensor] | None:
    """Return the weights of the values that a training starts with; None: random ones."""
    name = config.agent.start_from
    if not (config.agent.is_policy_gradient and config.agent.policy_gradient.start_values and name):
        return None
    with naming(_SETTING):
        policy, checkpoint = read(find(Path(name))), read(find(Path(name), prefer=LAST))
        found, theirs = checkpoint.part("values"), checkpoint.config()
    if not found:
        raise ConfigError(
            f"{_VALUES}: {name} has no values; name in {_SETTING} the run of a training with "
            "agent.learner=policy_gradient, or leave it at false"
        )
    state = checkpoint.document.state
    assert state is not None  # of a checkpoint with values
    if policy.document.kind == "best" and policy.document.decision != state.decision:
        raise ConfigError(
            f"{_VALUES}: the best policy of {name} is that of decision {policy.document.decision}, "
            f"its values are those of decision {state.decision}; give {checkpoint.path} in "
            f"{_SETTING}, or leave it at false"
        )
    if differing := [path for path, *_ in differences(_returns(theirs), _returns(config))]:
        raise ConfigError(
            f"{_VALUES}: the values of {name} are of other returns, by {', '.join(differing)}; "
            "train with the settings of that run, or leave it at false"
        )
    built = build_values(input_size(config.network, config.perception.layout), SIZE)
    try:
        require_equal_layout(found, built.state_dict())
    except ValueError as error:
        raise ConfigError(f"{_VALUES}: the values of {name} do not fit: {error}") from error
    return found


def _returns(config: TrainConfig) -> dict[str, object]:
    """Return the settings that make up the returns which values predict, by their keys."""
    terms = {f"rewards.{name}": to_dict(term) for name, term in config.rewards.items()}
    agent = config.agent
    return {"agent.gamma": agent.gamma, "agent.reward_scale": agent.reward_scale, **terms}


def start(config: TrainConfig, agent: Learner) -> Start | None:
    """Give the networks of a new training the weights that it starts with, if any; return them."""
    found, values = read_start(config), read_values(config)
    if found is not None:
        load_start_weights(found, agent)
    if values is not None:
        assert isinstance(agent, PolicyGradient)  # the only learner whose values can be given
        agent.values.load_state_dict(values)
    return found


def load_start_weights(start: Start, agent: Learner) -> None:
    """Give the networks of ``agent`` the weights that ``read_start`` returned."""
    module, risk = start
    for network in agent.starting:
        network.load_state_dict(module.state_dict())
    if risk is not None and agent.risk is not None:
        agent.risk.network.load_state_dict(risk.state_dict())


def _same_network(config: TrainConfig, name: str, module: torch.nn.Module) -> torch.nn.Module:
    """Return the training's network with the weights of ``module``, if both are one function.

    Settings that only change how it learns, such as a dropout, and names of weights may differ.
    """
    layout, network = config.perception.layout, config.network
    built = build_network(network, layout, len(ACTIONS)).eval()
    inputs = torch.randn(
        (_ROWS, input_size(network, layout)), generator=torch.Generator().manual_seed(0)
    )
    text = (
        f"{_SETTING}: {name} has another network than this training; give it the same network and "
        "settings of the network"
    )
    try:
        weights, own = module.state_dict(), built.state_dict()
        if [w.shape for w in weights.values()] != [w.shape for w in own.values()]:
            require_equal_layout(weights, own)  # names what differs
        built.load_state_dict(dict(zip(own, weights.values(), strict=True)))
        with torch.inference_mode():
            equal = torch.allclose(built(inputs), module(inputs), rtol=1e-4, atol=1e-4)
    except (ValueError, RuntimeError) as error:
        raise ConfigError(f"{text} ({str(error).splitlines()[0]})") from error
    if not equal:
        raise ConfigError(text)
    return built


_PART = "start"
"""Part of a checkpoint that holds the weights to begin with."""
_REPORTS = 4
"""Number of messages about the progress."""


class FinalFit:
    """Learns all labels of a training anew at its end (``teacher.final_updates``).

    A network that learns while the labels come meets the first ones most often, and the last ones,
    which its own best driving leads to, least.
    """

    def __init__(
        self,
        config: TrainConfig,
        layout: ObservationLayout,
        replay: Replay,
        seeds: tuple[int, np.random.SeedSequence],
        report: Callable[[str], None],
    ) -> None:
        """``seeds``: of the training's first weights, and of the batches."""
        self._config, self._layout, self._replay = config, layout, replay
        self._seeds, self._report = seeds, report
        self._on = bool(config.teacher.final_updates and config.teacher.teaches)
        self._start: Start | None = None

    def begin(self, found: Start | None) -> None:
        """Remember the weights that a new training starts with; their file may change later."""
        self._start = found if self._on else None

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return the weights to begin with, for the checkpoint of the run."""
        return {} if self._start is None else join({_PART: self._start[0].state_dict()})

    def restore(self, saved: Checkpoint) -> None:
        """Restore the weights to begin with."""
        if not (self._on and self._config.agent.start_from):
            return
        weights = saved.part(_PART)
        module = build_network(self._config.network, self._layout, len(ACTIONS))
        try:
            require_equal_layout(weights, module.state_dict())
        except ValueError as error:
            text = f"{saved.path}: its part {_PART} is not valid: {error}"
            raise CheckpointError(text) from error
        module.load_state_dict(weights)
        self._start = module, None

    def run(self, agent: Learner, stop: Callable[[], bool]) -> bool:
        """Do all updates and give the agent the weights; do nothing if none are configured.

        ``stop`` is called between updates. Return False, without a change, if it returns True; the
        next call begins anew and finds the same weights for the same labels.
        """
        config, count = self._config, self._config.teacher.final_updates
        if not self._on:
            return True
        rows = self._replay.labelled()
        if not len(rows):
            self._report("keeps what it has learnt: there are no labels to learn anew")
            return True
        self._report(f"learns the {len(rows):,} labels anew in {count:,} updates")
        without_risk = config.agent.model_copy(update={"risk": False})
        learner = D3qn(
            *(config.network, self._layout, without_risk),
            seed=self._seeds[0],
            device=config.device,
            teacher=config.teacher,
        )
        if self._start is not None:
            load_start_weights(self._start, learner)
        together, size = learner.settings.updates_together, learner.settings.batch_size
        rng, begun, told = np.random.default_rng(self._seeds[1]), time.monotonic(), 1
        for done in range(0, count, together):
            if stop():
                return False
            if done * _REPORTS >= told * count:
                left = (time.monotonic() - begun) * (count - done) / done
                self._report(f"{done:,} of {count:,} updates, {left:.0f} s left")
                told += 1
            batch = self._replay.sample(min(together, count - done) * size, rng, rows)
            learner.update(batch, done / count)
        agent.online.load_state_dict(learner.online.state_dict())
        agent.target.load_state_dict(learner.target.state_dict())
        return True
