"""What all learners share: an online and a target network, their optimiser, and the risk.

In: a network plugin and its layout. Out: a policy, and gradient steps on losses that a subclass
computes.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.frames import input_size
from flipperctl.agent.losses import Adam, descend, flatten_parameters
from flipperctl.agent.networks import Noise, build_network, record_plugin
from flipperctl.agent.risk import RiskLearner
from flipperctl.api import ACTIONS, Network, ObservationLayout
from flipperctl.config import Agent, Teacher
from flipperctl.errors import ConfigError
from flipperctl.guard import naming, refusal


def arrays(module: torch.nn.Module) -> dict[str, NDArray[np.generic]]:
    """Return a copy of a network's weights, for policies in other processes."""
    state = module.state_dict()
    return {name: tensor.cpu().numpy().copy() for name, tensor in state.items()}


def join(parts: Mapping[str, Mapping[str, torch.Tensor]]) -> dict[str, torch.Tensor]:
    """Return the tensors of all parts, their names after those of the parts."""
    return {f"{part}.{name}": t for part, state in parts.items() for name, t in state.items()}


def part(tensors: Mapping[str, torch.Tensor], name: str) -> dict[str, torch.Tensor]:
    """Return the tensors whose names begin with a part's name, without it."""
    start = f"{name}."
    return {key.removeprefix(start): t for key, t in tensors.items() if key.startswith(start)}


class Learner:
    """Online and target network, their optimiser, and the learner of the risk."""

    def __init__(
        self,
        network: Network,
        layout: ObservationLayout,
        settings: Agent,
        *,
        seed: int,
        device: str = "cpu",
        teacher: Teacher | None = None,
        privileged: int = 0,
    ) -> None:
        """``teacher``: settings of the imitation of the batches' labels; None without labels.

        ``privileged``: length of the batches' privileged states, 0 without them.
        """
        self.settings, self._seed, self._teacher = settings, seed, teacher
        self.device = torch.device(device)
        self._parts: dict[str, torch.nn.Module | Adam] = {}
        """The learner's state, by its names in a checkpoint."""
        inputs = input_size(network, layout)
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            built = build_network(network, layout, len(ACTIONS))
            beside = self._build_beside(inputs, privileged)
        self.risk = RiskLearner(inputs, seed=seed, device=self.device) if settings.risk else None
        """The learner of the risk, if there is one."""
        if not any(p.requires_grad for p in built.parameters()):
            raise refusal(
                network, "build", "built a network without trainable parameters", ConfigError
            )
        with naming(network, "build", ConfigError):
            self.online = built.to(self.device)
            self.target = copy.deepcopy(self.online).requires_grad_(False)
            # The parameters that learn lie in one vector for each network, so that the optimiser,
            # the clipping and the soft update are one operation each instead of one per layer.
            pairs = [
                (learns, follows)
                for learner, follower in [(self.online, self.target), *beside]
                for learns, follows in zip(learner.parameters(), follower.parameters(), strict=True)
                if learns.requires_grad
            ]
            self._parameters, followers = map(list, zip(*pairs, strict=True))
            self._online, self._target = map(flatten_parameters, (self._parameters, followers))
            saved = self.online.state_dict().keys()  # of buffers: statistics, but no noise
            self._buffers = [name for name, _ in self.online.named_buffers() if name in saved]
        for module in (self.online, self.target):
            record_plugin(module, network)
        self.optimiser = Adam(self._online)
        self._noise, self._target_noise = Noise(self.online), Noise(self.target)
        self._noise.acts()
        self._target_noise.acts()
        self.noise_rng = np.random.default_rng(seed)
        """Generator of the networks' exploration noise, if they have any."""
        own, self._parts = self._parts, {"online": self.online, "target": self.target}
        if self.risk is not None:
            self._parts |= {"risk": self.risk.network, "risk_optimiser": self.risk.optimiser}
        self._parts |= {"optimiser": self.optimiser, **own}

    def _build_beside(
        self, inputs: int, privileged: int
    ) -> list[tuple[torch.nn.Module, torch.nn.Module]]:
        """Build networks that learn from the same loss, each with one that follows it slowly."""
        return []

    @property
    def policy(self) -> torch.nn.Module:
        """The network that is validated and exported."""
        return self.target

    def policy_arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return a copy of the policy's weights, and of those of its risk, for other processes."""
        return arrays(self.policy) | ({} if self.risk is None else self.risk.arrays())

    @property
    def starting(self) -> tuple[torch.nn.Module, ...]:
        """The networks that begin with the weights of the training's start."""
        return self.online, self.target

    def _descend(self, loss: torch.Tensor, rate: float) -> None:
        """Take a gradient step of the online network; let the target follow."""
        descend(loss, self._parameters, self.optimiser, self.settings.gradient_norm, rate)
        with torch.no_grad():
            self._target.lerp_(self._online, self.settings.target_rate)
            for name in self._buffers:  # statistics follow as weights do; integer counts are copied
                online, target = self.online.get_buffer(name), self.target.get_buffer(name)
                if online.is_floating_point():
                    target.lerp_(online, self.settings.target_rate)
                else:
                    target.copy_(online)

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return the learner's state: its networks and the optimisers' moments."""
        return join({name: made.state_dict() for name, made in self._parts.items()})

    def restore(self, tensors: Mapping[str, torch.Tensor], steps: int) -> None:
        """Restore the tensors that ``tensors`` returned after ``steps`` gradient steps."""
        for name, made in self._parts.items():
            made.load_state_dict(part(tensors, name))
            if isinstance(made, Adam):
                made.steps = steps
